"""Stability under bounded errors: certificates by interval arithmetic, for the default law."""
