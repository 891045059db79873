"""Messages that nodes publish, and paths that they receive."""

from __future__ import annotations

from typing import Any

from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped, TransformStamped
from nav_msgs.msg import Odometry, Path
from rclpy.serialization import deserialize_message
from std_msgs.msg import Header

from diffbot_control.goals.record import MAX_PATH_POSES
from diffbot_control.ros.messages.fields import check_frame, fill_pose, fill_unestimated, set_stamp, stamp_ns
from diffbot_control.ros.transforms import NO_TRANSFORMS, LastTransform, Transforms, pose_in_frame
from diffbot_core.errors import BadMessageError
from diffbot_core.geometry import Pose, quaternion_of_yaw

try:
    from tf2_msgs.msg import TFMessage as TFMessage  # noqa: PLC0414
except ImportError:  # not available as a wheel; without it the nodes do not publish TF, and log this once
    TFMessage = None


_MAX_POSE_BYTES = 256
"""Largest size of one pose in a path [bytes]: 72 plus the name of its frame."""


def read_path(data: bytes) -> Path:
    """Deserialise a path, unless it is far too long, since deserialisation blocks the node.

    Raises:
        BadMessageError: if the path is too long or cannot be deserialised.
    """
    if len(data) > _MAX_POSE_BYTES * (MAX_PATH_POSES + 1):
        raise BadMessageError("path too long", f"{len(data)} bytes, at most {MAX_PATH_POSES} poses")
    try:
        return deserialize_message(data, Path)
    except Exception as error:  # rclpy raises several types of errors for bytes that are not a path
        raise BadMessageError("path cannot be read", " ".join(str(error).split())) from None


def path_from(path: Path, frame: str, transforms: Transforms = NO_TRANSFORMS) -> list[Pose]:
    """Return the poses of a path in ``frame``; a pose without a frame has the frame and the time of the path.

    Raises:
        BadMessageError: if the path is empty or has more than MAX_PATH_POSES poses, or a pose cannot be used.
    """
    header, length = path.header, len(path.poses)
    if not header.frame_id:
        check_frame(header.frame_id, frame)
    if not length:
        raise BadMessageError("path is empty")
    if length > MAX_PATH_POSES:
        raise BadMessageError("path too long", f"{length} poses, at most {MAX_PATH_POSES}")
    last = LastTransform(lambda: transforms)
    if header.frame_id != frame:
        # The frame of the path must be valid even if each pose has its own frame.
        last.lookup(frame, header.frame_id, stamp_ns(header.stamp))
    return [
        pose_in_frame(stamped.pose, stamped.header if stamped.header.frame_id else header, frame, last)
        for stamped in path.poses
    ]


def goal_message(pose: Pose, frame: str, nanoseconds: int) -> PoseStamped:
    """Return a goal pose with this stamp [ns]."""
    message = PoseStamped(header=Header(frame_id=frame))
    set_stamp(message.header.stamp, nanoseconds)
    fill_pose(message.pose, pose)
    return message


def odometry_message(frame: str, child_frame: str) -> Odometry:
    """Return an Odometry to be filled repeatedly, with a large variance of z, roll and pitch."""
    message = Odometry(header=Header(frame_id=frame), child_frame_id=child_frame)
    fill_unestimated(message.pose.covariance, message.twist.covariance)
    return message


def pose_message(frame: str) -> PoseWithCovarianceStamped:
    """Return a PoseWithCovarianceStamped to be filled repeatedly, with a large variance of z, roll and pitch."""
    message = PoseWithCovarianceStamped(header=Header(frame_id=frame))
    fill_unestimated(message.pose.covariance)
    return message


def transform_message(stamp: int, parent: str, child: str, pose: Pose) -> Any:
    """Return a TFMessage with one transform: the pose of ``child`` in ``parent``. Requires tf2_msgs."""
    transform = TransformStamped(header=Header(frame_id=parent), child_frame_id=child)
    set_stamp(transform.header.stamp, stamp)
    transform.transform.translation.x = float(pose.x)
    transform.transform.translation.y = float(pose.y)
    z, w = quaternion_of_yaw(float(pose.theta))
    transform.transform.rotation.z, transform.transform.rotation.w = z, w
    return TFMessage(transforms=[transform])
