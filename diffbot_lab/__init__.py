"""Studies and the command ``diffbot``: demonstration, campaigns, the paper's experiments, stability, benchmarks.

Conventions as in :mod:`diffbot_core`.
"""
