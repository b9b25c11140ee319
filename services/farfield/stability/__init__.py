"""Where the arithmetic ends: formulas and predicates against 50 digits, extreme levels, relations that hold exactly."""
