"""Studies: laws from publications, benchmarks of laws and filter, campaigns, the paper, certificates, Gymnasium.

Conventions as in :mod:`diffbot_core`. The nodes do not import this package. Its commands and laws are entry points.
"""
