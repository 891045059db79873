"""What every room needs: errors, the schema of configurations, geometry, kinematics, uncertainty, health, files.

Conventions, stated once (REP-103, REP-105):

- SI units; angles in radians, wrapped to (-pi, pi]; yaw counter-clockwise, x forward.
- Frames: ``map`` (world), ``odom`` (drifts), ``base_link`` (robot). A *goal frame* has its origin in the goal pose
  and its x axis along the goal's heading; the laws live in it.
- Time in messages and between modules is an integer of nanoseconds; a sampling time is a float of seconds.
- Symbols are those of the paper (N. T. T. Van, P. M. Duong, T. Q. Vinh, VCM-2014), listed in
  docs/explanation/symbols.md.

Nothing here but the room ``ros`` imports ROS.
"""

from diffbot_core.data_sheet import DataSheet
from diffbot_core.errors import BadMessageError, DiffbotError, InvalidValueError, ReplacedNameError
from diffbot_core.geometry import Pose, into_frame, origin_of_frame, out_of_frame, wrap_angle
from diffbot_core.kinematics import Twist, WheelGeometry, WheelSpeeds, body_twist, wheel_speeds
from diffbot_core.schema import Spec, build, parameters_of, to_dict
from diffbot_core.uncertainty import CERTAIN, Estimate, Uncertainty

__all__ = [
    "CERTAIN",
    "BadMessageError",
    "DataSheet",
    "DiffbotError",
    "Estimate",
    "InvalidValueError",
    "Pose",
    "ReplacedNameError",
    "Spec",
    "Twist",
    "Uncertainty",
    "WheelGeometry",
    "WheelSpeeds",
    "body_twist",
    "build",
    "into_frame",
    "origin_of_frame",
    "out_of_frame",
    "parameters_of",
    "to_dict",
    "wheel_speeds",
    "wrap_angle",
]
