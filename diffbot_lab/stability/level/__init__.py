"""The level of V above which it decreases for every noise: search, file and check."""
