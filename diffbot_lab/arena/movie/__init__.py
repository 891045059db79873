"""The moving picture of the arena's drives."""
