"""Builds interfaces that no wheel contains, for the user who asks for it: ``diffbot interfaces build``."""
