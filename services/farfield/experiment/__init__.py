"""Experiments: a level in, figures about farfield out, with tables and plots; nothing in them is made by what they judge."""
