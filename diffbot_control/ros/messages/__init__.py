"""Conversion of messages to values and of values to messages."""
