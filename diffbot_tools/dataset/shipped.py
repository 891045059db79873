"""Parameters of the node ``ekf`` that imported bags are given: one table for all robots of a data set.

None of them was fitted to a single robot: they describe the kind of robot and its sensors.
"""

from __future__ import annotations

from types import MappingProxyType

MRCLAM = MappingProxyType(
    {
        # iRobot Create.
        "wheel_separation": 0.26,
        "wheel_radius": 0.033,
        # Its odometry is the command, uncalibrated: scale errors of about 10 %, and a dead time.
        "wheel_radius_sigma": 0.1,
        "wheel_separation_sigma": 0.1,
        "wheel_radius_walk": 1e-3,
        "wheels_as_configured": 0.0,
        "odometry_delay": 0.25,
        # A camera at markers: the error grows with the distance and lasts longer than the time between two frames; some
        # markers are misread.
        "landmark_range_sigma": 0.03,
        "landmark_range_sigma_per_metre": 0.025,
        "landmark_bearing_sigma": 0.02,
        "landmark_correlation_time": 1.0,
        "landmark_range_offset": 0.04,
        "landmark_range_offset_sigma": 0.03,
        "landmark_range_scale": 0.025,
        "landmark_range_scale_sigma": 0.02,
        "landmark_bearing_offset_sigma": 0.01,
        "landmark_gate": "weigh",
        "gate_probability": 0.99,
    }
)
LABYRINTH = MappingProxyType(
    {
        "wheel_radius_sigma": 0.1,
        "wheel_separation_sigma": 0.1,
        "wheel_radius_walk": 1e-3,
        "wheels_as_configured": 0.0,
        "landmark_gate": "weigh",
    }
)
"""Beside the wheel separation, which the data name."""
