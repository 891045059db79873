"""Stability under bounded noise: a picture of V on a grid, and certificates by interval arithmetic."""
