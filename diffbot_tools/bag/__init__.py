"""The command ``diffbot bag``: work on recorded bags."""
