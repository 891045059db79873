"""Interval arithmetic: of the makers, compiled, and in numpy, widened, of a checker."""
