"""Calibration of a robot from a recorded drive: maximum likelihood of the filter's innovations, without a ground truth."""
