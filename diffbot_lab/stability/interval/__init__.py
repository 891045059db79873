"""Interval arithmetic: rounded outward for compiled kernels, and in plain numpy for the checker."""
