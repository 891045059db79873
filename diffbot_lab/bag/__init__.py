"""The commands ``diffbot bag ...``."""
