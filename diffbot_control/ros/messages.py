"""Messages to values and back, for all nodes. What comes in is checked; a bad message raises BadMessageError."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from functools import partial
from typing import Any, NamedTuple

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
from sensor_msgs.msg import Imu, JointState, PointCloud2
from std_msgs.msg import Float64MultiArray, Header, MultiArrayDimension

from diffbot_control.filter.covariance import check_covariance, uncertainty_of
from diffbot_control.filter.ekf import Array
from diffbot_control.filter.measurements import Measurement
from diffbot_control.ros.landmark_cloud import LandmarkPoint, landmark_points
from diffbot_core.errors import BadMessageError
from diffbot_core.geometry import FARTHEST, Pose, quaternion_of_yaw, yaw_of_quaternion
from diffbot_core.kinematics import Twist, WheelSpeeds
from diffbot_core.uncertainty import CERTAIN, Uncertainty

try:
    # The alias marks it as meant for others too.
    from tf2_msgs.msg import TFMessage as TFMessage  # noqa: PLC0414
except ImportError:  # no wheel carries tf2; the nodes say once that they publish no TF
    TFMessage = None


class KnownNoise(NamedTuple):
    """What is known of a sensor's noise beside its messages."""

    R: Array | None = None
    """covariance, the fallback; None if there is none"""
    always: bool = False
    """do not look at the messages'"""


MESSAGE_NOISE = KnownNoise()
"""Nothing: the messages' covariances count, and a message without one is dropped."""
NANO = 1_000_000_000
FASTEST = 1e4
"""[m/s], [rad/s] speeds beyond it are a slip."""

# Places of (x, y, yaw) in the row-major 6 x 6 covariance of REP-103's (x, y, z, roll, pitch, yaw).
_PLANAR = np.array([0, 1, 5, 6, 7, 11, 30, 31, 35])


def stamp_ns(stamp: Time) -> int:
    """Return a stamp as nanoseconds; it is sent on, so it must be one that :func:`set_stamp` can write."""
    if stamp.nanosec >= NANO:
        raise BadMessageError("stamp not normalised", f"{stamp.nanosec} ns")
    return int(stamp.sec) * NANO + int(stamp.nanosec)


def set_stamp(stamp: Time, nanoseconds: int) -> None:
    """Write nanoseconds into a stamp in place."""
    stamp.sec, stamp.nanosec = divmod(nanoseconds, NANO)


def check_frame(frame: str, expected: str, field: str = "frame_id") -> None:
    """Refuse a message of another frame."""
    if frame != expected:
        raise BadMessageError(f"wrong {field}", f"{frame[:80]!r}, not {expected!r}")


def check_numbers(numbers: Iterable[float], limit: float, what: str) -> None:
    """Refuse numbers that are not finite or that no robot reaches."""
    for number in numbers:
        if not -limit <= number <= limit:
            kind = f"{what} out of range" if math.isfinite(number) else f"{what} not finite"
            raise BadMessageError(kind, f"{number!r}")


def yaw_of(orientation: Quaternion) -> float:
    """Yaw [rad] of an orientation; its length has to be 1 within what rounding by hand may do."""
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
    check_numbers((x, y), FARTHEST, "position")
    return Pose(x, y, yaw_of(message.orientation))


def planar_covariance(covariance: Any) -> Array:
    """(3, 3) covariance of x, y, yaw out of the 36 numbers of a pose covariance."""
    return check_covariance(np.asarray(covariance, dtype=float)[_PLANAR].reshape(3, 3))


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
) -> tuple[int, Pose, Uncertainty]:
    """Stamp [ns], pose and uncertainty of an estimate in ``frame``; without a covariance (all zero) it is certain.

    An Odometry says whose pose it is: it has to be that of ``child_frame``. Its twist is not looked at.
    """
    check_frame(message.header.frame_id, frame)
    if isinstance(message, Odometry):
        check_frame(message.child_frame_id, child_frame, "child_frame_id")
    pose = pose_of(message.pose.pose)
    covariance = np.asarray(message.pose.covariance, dtype=float)
    uncertainty = uncertainty_of(planar_covariance(covariance)) if covariance.any() else CERTAIN
    return stamp_ns(message.header.stamp), pose, uncertainty


def fix_from(message: PoseWithCovarianceStamped, frame: str, noise: KnownNoise = MESSAGE_NOISE) -> Measurement:
    """Return a pose fix in ``frame``; for its covariance see :func:`noise_of`."""
    check_frame(message.header.frame_id, frame)
    pose = pose_of(message.pose.pose)
    R = noise_of(lambda: planar_covariance(message.pose.covariance), noise)
    return Measurement(stamp_ns(message.header.stamp), np.array(pose), R)


def heading_from(message: Imu, frame: str, noise: KnownNoise = MESSAGE_NOISE) -> Measurement:
    """Return a compass heading of a sensor fixed to ``frame``; REP-145: covariance[0] = -1 means no orientation."""
    check_frame(message.header.frame_id, frame)
    if message.orientation_covariance[0] == -1.0:
        raise BadMessageError("no orientation in it")
    yaw = yaw_of(message.orientation)
    R = noise_of(lambda: check_covariance(np.array([[float(message.orientation_covariance[8])]])), noise)
    return Measurement(stamp_ns(message.header.stamp), np.array([yaw]), R)


def landmarks_from(
    message: PointCloud2, frame: str, points: dict[int, tuple[float, float]], noise: KnownNoise
) -> tuple[list[Measurement], int]:
    """Return range and bearing of each known landmark in a cloud in ``frame``, and how many are not known.

    ``points``: x, y [m] of each by its number; the covariance is the message's where it has both variances.
    """
    check_frame(message.header.frame_id, frame)
    stamp, measurements, unknown = stamp_ns(message.header.stamp), [], 0
    for seen in landmark_points(message):
        if seen.number not in points:
            unknown += 1
            continue
        R = noise_of(partial(_landmark_covariance, seen), noise)
        measurements.append(Measurement(stamp, np.array((seen.distance, seen.bearing)), R, points[seen.number]))
    return measurements, unknown


def _landmark_covariance(seen: LandmarkPoint) -> Array:
    return check_covariance(np.diag((seen.var_distance, seen.var_bearing)))


def noise_of(read: Callable[[], Array], noise: KnownNoise) -> Array:
    """Return the covariance that ``read`` finds in a message, or the fallback.

    The fallback is taken where it is given and the message's is not usable or not wanted.

    Raises:
        BadMessageError: if the message's is not usable and there is no fallback.
    """
    if noise.R is not None and noise.always:
        return noise.R
    try:
        return read()
    except BadMessageError:
        if noise.R is None:
            raise
        return noise.R


def odometry_from(message: Odometry, child_frame: str) -> tuple[int, Twist, tuple[float, float, float]]:
    """Stamp [ns], twist in ``child_frame`` and its (var(v), cov(v, omega), var(omega)); all zero if not given."""
    check_frame(message.child_frame_id, child_frame, "child_frame_id")
    twist = twist_from(message.twist.twist)
    covariance = message.twist.covariance
    variances = float(covariance[0]), float(covariance[5]), float(covariance[35])
    if any(variances):
        check_covariance(np.array([variances[:2], variances[1:]]))
    return stamp_ns(message.header.stamp), twist, variances


def twist_from(message: TwistMessage) -> Twist:
    """Return the planar part of a twist."""
    v, omega = message.linear.x, message.angular.z
    check_numbers((v, omega), FASTEST, "velocity")
    return Twist(v, omega)


def wheel_speeds_from(message: JointState, left: str, right: str) -> tuple[int, WheelSpeeds]:
    """Stamp [ns] and speeds of the two wheels of these joint names."""
    try:
        speeds = WheelSpeeds(message.velocity[message.name.index(left)], message.velocity[message.name.index(right)])
    except (ValueError, IndexError):
        raise BadMessageError("wheel joints missing", f"no velocity of {left!r} and {right!r}") from None
    check_numbers(speeds, FASTEST, "wheel speed")
    return stamp_ns(message.header.stamp), speeds


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


def fill_twist_covariance(covariance: Any, variances: tuple[float, float, float]) -> None:
    """Write (var(v), cov(v, omega), var(omega)) into the 36 numbers of a twist covariance."""
    covariance[0], covariance[5], covariance[30], covariance[35] = (
        variances[0],
        variances[1],
        variances[1],
        variances[2],
    )


def goal_message(pose: Pose, frame: str, nanoseconds: int) -> PoseStamped:
    """Return a goal."""
    message = PoseStamped(header=Header(frame_id=frame))
    set_stamp(message.header.stamp, nanoseconds)
    fill_pose(message.pose, pose)
    return message


def odometry_message(frame: str, child_frame: str) -> Odometry:
    """Return an Odometry to be filled again and again; what a planar robot does not know has a huge variance."""
    message = Odometry(header=Header(frame_id=frame), child_frame_id=child_frame)
    for covariance in (message.pose.covariance, message.twist.covariance):
        covariance[[14, 21, 28]] = 1e6
    message.twist.covariance[7] = 1e-9  # it does not move sideways
    return message


def pose_message(frame: str) -> PoseWithCovarianceStamped:
    """Return a PoseWithCovarianceStamped to be filled again and again."""
    message = PoseWithCovarianceStamped(header=Header(frame_id=frame))
    message.pose.covariance[[14, 21, 28]] = 1e6
    return message


def labelled_array(labels: tuple[str, ...]) -> Float64MultiArray:
    """Return an array of one number per label; the labels stand in the layout, in order."""
    message = Float64MultiArray()
    message.layout.dim = [MultiArrayDimension(label=label, size=1, stride=1) for label in labels]
    message.data = [0.0] * len(labels)
    return message


def twist_message(stamped: bool, frame: str) -> TwistMessage | TwistStamped:
    """Return a command to be filled again and again."""
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
