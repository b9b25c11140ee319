"""Placement database -> Report: verdict, figures, independent verification."""
