"""Studies: laws of others, the arena, campaigns, the paper's experiments, stability, benchmarks of the filter, gym.

Conventions as in :mod:`diffbot_core`. Nothing that drives a robot imports this room; its commands and laws are found
by entry points.
"""
