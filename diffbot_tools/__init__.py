"""Programs for the user of a robot: the command ``diffbot``, reports of bags, the live page, calibration.

Conventions as in :mod:`diffbot_core`.
"""
