"""Checks certificates of the tuned law, with formulas and rounding of its own: no code of what makes them."""
