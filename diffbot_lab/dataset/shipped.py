"""Parameters of the node ``ekf`` that imported bags are given: one table for all robots of a data set.

None of them was fitted to a single robot. Whatever the filter can be told of the kind of robot goes here.
"""

from __future__ import annotations

from types import MappingProxyType

MRCLAM = MappingProxyType(
    {
        # iRobot Create.
        "wheel_separation": 0.26,
        "wheel_radius": 0.033,
        # Its odometry is the command, uncalibrated: scale errors of about 10 %.
        "wheel_radius_sigma": 0.1,
        "wheel_radius_walk": 1e-3,
        # An error per message, so at 67 Hz even the largest value allowed is little per metre.
        "wheel_noise": 1.0,
        # Measurements of neighbouring times share their errors, so one is worth less than its scatter says.
        "landmark_range_sigma": 0.15,
        "landmark_bearing_sigma": 0.06,
    }
)
LABYRINTH = MappingProxyType(
    {
        "wheel_radius_sigma": 0.1,
        "wheel_radius_walk": 1e-3,
        "wheel_noise": 1.0,
    }
)
"""Beside the wheel separation, which the data name."""
