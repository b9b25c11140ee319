"""Candidates -> Placement: the least memory that meets the budget in every problem view."""
