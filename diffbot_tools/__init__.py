"""What the user of a robot runs: the command ``diffbot``, recorded drives, the live page, calibration.

Conventions as in :mod:`diffbot_core`.
"""
