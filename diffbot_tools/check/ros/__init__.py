"""The node of ``diffbot check``."""
