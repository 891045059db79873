"""One's own robot: its description in one file, what is wrong with it, and what it would do in the simulation."""
