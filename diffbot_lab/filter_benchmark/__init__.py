"""Filters side by side, on simulated and on recorded drives."""
