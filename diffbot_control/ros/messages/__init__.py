"""Conversions between messages and the values of the core."""
