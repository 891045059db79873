"""Checks certificates, with formulas and rounding of its own: no code of what makes them."""
