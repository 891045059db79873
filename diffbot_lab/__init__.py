"""Studies: published laws and their benchmark, campaigns, the paper, certificates, the benchmark of the filter, gym.

Conventions as in :mod:`diffbot_core`. Nothing that drives a robot imports this room; its commands and laws are found
by entry points.
"""
