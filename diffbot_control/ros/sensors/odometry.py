"""The motion: an Odometry, or the wheel speeds of a JointState."""

from __future__ import annotations

from typing import Any

from diffbot_control.filter.covariance import check_rows
from diffbot_control.filter.odometry import OdometryStep
from diffbot_control.ros.messages.fields import MAX_SPEED, check_frame, check_numbers, stamp_ns, twist_from
from diffbot_core.errors import BadMessageError
from diffbot_core.kinematics import TwistCovariance, WheelSpeeds


def odometry_from(message: Any, child_frame: str) -> OdometryStep:
    """Return stamp, twist in ``child_frame`` and its covariance; all zero if unknown: the caller has the fallback."""
    check_frame(message.child_frame_id, child_frame, "child_frame_id")
    measured = message.twist
    twist, covariance = twist_from(measured.twist), measured.covariance
    var_v, cov, var_omega = float(covariance[0]), float(covariance[5]), float(covariance[35])
    if any((var_v, cov, var_omega)):
        check_rows([[var_v, cov], [cov, var_omega]])
    return OdometryStep(stamp_ns(message.header.stamp), twist, TwistCovariance(var_v, cov, var_omega))


def wheel_speeds_from(message: Any, left: str, right: str) -> tuple[int, WheelSpeeds]:
    """Stamp [ns] and speeds of the two wheels of these joint names."""
    try:
        speeds = WheelSpeeds(message.velocity[message.name.index(left)], message.velocity[message.name.index(right)])
    except (ValueError, IndexError):
        raise BadMessageError("wheel joints missing", f"no velocity of {left!r} and {right!r}") from None
    check_numbers(speeds, MAX_SPEED, "wheel speed")
    return stamp_ns(message.header.stamp), speeds
