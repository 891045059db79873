"""Calibration of a robot from a recorded drive: maximum likelihood of the innovations, no ground truth."""
