"""Cells around the goal, the ranks of cells, and the geometry of one step."""
