"""Conversion between messages and values, for all nodes. Input is checked; a bad message raises BadMessageError."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any

import numpy as np
from builtin_interfaces.msg import Time
from geometry_msgs.msg import (
    PoseStamped,
    PoseWithCovarianceStamped,
    Quaternion,
    TransformStamped,
    TwistStamped,
)
from geometry_msgs.msg import (
    Twist as TwistMessage,
)
from nav_msgs.msg import Odometry, Path
from std_msgs.msg import Float64MultiArray, Header, MultiArrayDimension

from diffbot_control.filter.covariance import check_covariance, uncertainty_of
from diffbot_control.filter.measurements import Array
from diffbot_core.errors import BadMessageError
from diffbot_core.geometry import MAX_COORDINATE, Pose, quaternion_of_yaw, yaw_of_quaternion
from diffbot_core.kinematics import Twist, TwistCovariance
from diffbot_core.uncertainty import Uncertainty
from diffbot_core.units import NS_PER_S

try:
    # The alias marks it as a re-export.
    from tf2_msgs.msg import TFMessage as TFMessage  # noqa: PLC0414
except ImportError:  # no wheel contains tf2_msgs; the nodes log once that they publish no TF
    TFMessage = None


MAX_SPEED = 1e4
"""[m/s], [rad/s] larger speeds are refused as errors."""

# Places of (x, y, yaw) in the row-major 6 x 6 covariance of REP-103's (x, y, z, roll, pitch, yaw).
_PLANAR = np.array([0, 1, 5, 6, 7, 11, 30, 31, 35])


def stamp_ns(stamp: Time) -> int:
    """Return a stamp as nanoseconds; it is copied to answers, so it must be one that :func:`set_stamp` can write."""
    if stamp.nanosec >= NS_PER_S:
        raise BadMessageError("stamp not normalised", f"{stamp.nanosec} ns")
    return int(stamp.sec) * NS_PER_S + int(stamp.nanosec)


def set_stamp(stamp: Time, nanoseconds: int) -> None:
    """Write nanoseconds into a stamp in place."""
    stamp.sec, stamp.nanosec = divmod(nanoseconds, NS_PER_S)


def check_frame(frame: str, expected: str, field: str = "frame_id") -> None:
    """Refuse a message in another frame than ``expected``."""
    if frame != expected:
        raise BadMessageError(f"wrong {field}", f"{frame[:80]!r}, not {expected!r}")


def check_numbers(numbers: Iterable[float], limit: float, what: str) -> None:
    """Refuse numbers that are not finite or larger than ``limit``; ``what`` names them in the error."""
    for number in numbers:
        if not -limit <= number <= limit:
            kind = f"{what} out of range" if math.isfinite(number) else f"{what} not finite"
            raise BadMessageError(kind, f"{number!r}")


def yaw_of(orientation: Quaternion) -> float:
    """Yaw [rad] of an orientation; its squared length may differ from 1 by a tenth, for rounding by hand."""
    x, y, z, w = orientation.x, orientation.y, orientation.z, orientation.w
    square = x * x + y * y + z * z + w * w
    if not math.isfinite(square):
        raise BadMessageError("orientation not finite")
    if not 0.9 <= square <= 1.1:
        raise BadMessageError("orientation is no unit quaternion", f"squared length {square:g}")
    return yaw_of_quaternion(x, y, z, w)


def pose_of(message: Any) -> Pose:
    """Planar pose of a geometry_msgs/Pose."""
    x, y = message.position.x, message.position.y
    check_numbers((x, y), MAX_COORDINATE, "position")
    return Pose(x, y, yaw_of(message.orientation))


def planar_covariance(covariance: Any) -> Array:
    """(3, 3) covariance of x, y, yaw out of the 36 numbers of a pose covariance."""
    return check_covariance(_planar_block(covariance))


def _planar_block(covariance: Any) -> Array:
    block: Array = np.asarray(covariance, dtype=float)[_PLANAR].reshape(3, 3)
    return block


def goal_from(message: PoseStamped, frame: str) -> Pose:
    """Return the goal, which has to be given in ``frame``."""
    check_frame(message.header.frame_id, frame)
    return pose_of(message.pose)


def path_from(message: Path, frame: str) -> list[Pose]:
    """Return the poses of a path, which has to be given in ``frame``; a pose without a frame is in the path's."""
    check_frame(message.header.frame_id, frame)
    if not message.poses:
        raise BadMessageError("path is empty")
    for pose in message.poses:
        check_frame(pose.header.frame_id or frame, frame)
    return [pose_of(pose.pose) for pose in message.poses]


def pose_from(
    message: PoseWithCovarianceStamped | Odometry, frame: str, child_frame: str
) -> tuple[int, Pose, Uncertainty | None]:
    """Stamp [ns], pose and uncertainty of an estimate in ``frame``; None if the covariance is all zero: unknown.

    Only the covariance of x, y and yaw counts. An Odometry has to be that of ``child_frame``; its twist is ignored.
    """
    check_frame(message.header.frame_id, frame)
    if isinstance(message, Odometry):
        check_frame(message.child_frame_id, child_frame, "child_frame_id")
    pose = pose_of(message.pose.pose)
    covariance = _planar_block(message.pose.covariance)
    uncertainty = uncertainty_of(check_covariance(covariance)) if covariance.any() else None
    return stamp_ns(message.header.stamp), pose, uncertainty


def twist_from(message: TwistMessage) -> Twist:
    """Return the planar part of a twist."""
    v, omega = message.linear.x, message.angular.z
    check_numbers((v, omega), MAX_SPEED, "velocity")
    return Twist(v, omega)


def fill_pose(message: Any, pose: Pose) -> None:
    """Write ``pose`` into a geometry_msgs/Pose in place."""
    message.position.x = float(pose.x)
    message.position.y = float(pose.y)
    fill_yaw(message.orientation, pose.theta)


def fill_yaw(orientation: Quaternion, yaw: float) -> None:
    """Write a rotation by ``yaw`` [rad] about z in place; x and y have to be 0 already."""
    orientation.z, orientation.w = quaternion_of_yaw(float(yaw))


def fill_planar_covariance(covariance: Any, P: Array) -> None:
    """Write a (3, 3) covariance of x, y, yaw into the 36 numbers of a message, whose other entries stay."""
    covariance[_PLANAR] = P.reshape(9)


def fill_twist(message: TwistMessage, twist: Twist) -> None:
    """Write ``twist`` into a message in place."""
    message.linear.x = float(twist.v)
    message.angular.z = float(twist.omega)


def fill_twist_covariance(covariance: Any, M: TwistCovariance) -> None:
    """Write ``M`` into the 36 numbers of a twist covariance."""
    covariance[0], covariance[35] = M.var_v, M.var_omega
    covariance[5] = covariance[30] = M.cov_v_omega


def goal_message(pose: Pose, frame: str, nanoseconds: int) -> PoseStamped:
    """Return a goal."""
    message = PoseStamped(header=Header(frame_id=frame))
    set_stamp(message.header.stamp, nanoseconds)
    fill_pose(message.pose, pose)
    return message


def odometry_message(frame: str, child_frame: str) -> Odometry:
    """Return an Odometry to be filled repeatedly; z, roll and pitch, which are not estimated, get a huge variance."""
    message = Odometry(header=Header(frame_id=frame), child_frame_id=child_frame)
    for covariance in (message.pose.covariance, message.twist.covariance):
        covariance[[14, 21, 28]] = 1e6
    message.twist.covariance[7] = 1e-9  # no motion sideways
    return message


def pose_message(frame: str) -> PoseWithCovarianceStamped:
    """Return a PoseWithCovarianceStamped to be filled repeatedly."""
    message = PoseWithCovarianceStamped(header=Header(frame_id=frame))
    message.pose.covariance[[14, 21, 28]] = 1e6
    return message


def labelled_array(labels: tuple[str, ...]) -> Float64MultiArray:
    """Return an array of one number per label; the layout lists the labels in order."""
    message = Float64MultiArray()
    message.layout.dim = [MultiArrayDimension(label=label, size=1, stride=1) for label in labels]
    message.data = [0.0] * len(labels)
    return message


def twist_message(stamped: bool, frame: str) -> TwistMessage | TwistStamped:
    """Return a command to be filled repeatedly."""
    return TwistStamped(header=Header(frame_id=frame)) if stamped else TwistMessage()


def transform_message(stamp: int, parent: str, child: str, pose: Pose) -> Any:
    """Return a TFMessage with one transform: ``pose`` of ``child`` in ``parent``. Needs tf2_msgs."""
    transform = TransformStamped(header=Header(frame_id=parent), child_frame_id=child)
    set_stamp(transform.header.stamp, stamp)
    transform.transform.translation.x = float(pose.x)
    transform.transform.translation.y = float(pose.y)
    z, w = quaternion_of_yaw(float(pose.theta))
    transform.transform.rotation.z, transform.transform.rotation.w = z, w
    return TFMessage(transforms=[transform])
