"""Conversion between messages and values, for all nodes. Input is checked; a bad message raises BadMessageError."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from geometry_msgs.msg import (
    PoseStamped,
    PoseWithCovarianceStamped,
    TransformStamped,
    TwistStamped,
)
from geometry_msgs.msg import (
    Twist as TwistMessage,
)
from nav_msgs.msg import Odometry, Path
from std_msgs.msg import Float64MultiArray, Header, MultiArrayDimension

from diffbot_control.filter.covariance import check_covariance, uncertainty_of
from diffbot_control.goals.goal_record import MAX_PATH_POSES
from diffbot_control.ros.messages.fields import (
    check_frame,
    fill_pose,
    fill_unestimated,
    planar_block,
    pose_of,
    set_stamp,
    stamp_ns,
)
from diffbot_control.ros.transforms import NO_TRANSFORMS, LastTransform, Transforms, pose_in_frame
from diffbot_core.cdr import PathFields
from diffbot_core.errors import BadMessageError
from diffbot_core.geometry import Pose, quaternion_of_yaw
from diffbot_core.uncertainty import Uncertainty

try:
    # The alias marks it as a re-export.
    from tf2_msgs.msg import TFMessage as TFMessage  # noqa: PLC0414
except ImportError:  # no wheel contains tf2_msgs; the nodes log once that they publish no TF
    TFMessage = None


def goal_from(message: PoseStamped, frame: str, transforms: Transforms = NO_TRANSFORMS) -> Pose:
    """Return the goal in ``frame``; one that is given in another frame is transformed, once."""
    return pose_in_frame(message.pose, message.header, frame, transforms)


def path_from(
    message: Path, frame: str, transforms: Transforms = NO_TRANSFORMS, max_poses: int = MAX_PATH_POSES
) -> list[Pose]:
    """Return the poses of a path in ``frame``; a pose without a frame has frame and time of the path."""
    return list(
        poses_along(PathFields(message.header, len(message.poses), message.poses), frame, transforms, max_poses)
    )


def poses_along(path: PathFields, frame: str, transforms: Transforms, max_poses: int) -> Iterator[Pose]:
    """Check a path's header and length, and return an iterator that checks and transforms pose by pose.

    Raises:
        BadMessageError: if the path cannot be used; the iterator raises it for a pose.
    """
    header = path.header
    if not header.frame_id:
        check_frame(header.frame_id, frame)
    if not path.length:
        raise BadMessageError("path is empty")
    if path.length > max_poses:
        raise BadMessageError("path too long", f"{path.length} poses, max_path_poses = {max_poses}")
    transforms = LastTransform(transforms)
    if header.frame_id != frame:
        # Refused even if each pose has a frame of its own: the header is wrong.
        transforms.lookup(frame, header.frame_id, stamp_ns(header.stamp))
    return (
        pose_in_frame(one.pose, one.header if one.header.frame_id else header, frame, transforms) for one in path.poses
    )


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
    covariance = planar_block(message.pose.covariance)
    uncertainty = uncertainty_of(check_covariance(covariance)) if covariance.any() else None
    return stamp_ns(message.header.stamp), pose, uncertainty


def goal_message(pose: Pose, frame: str, nanoseconds: int) -> PoseStamped:
    """Return a goal."""
    message = PoseStamped(header=Header(frame_id=frame))
    set_stamp(message.header.stamp, nanoseconds)
    fill_pose(message.pose, pose)
    return message


def odometry_message(frame: str, child_frame: str) -> Odometry:
    """Return an Odometry to be filled repeatedly; z, roll and pitch, which are not estimated, get a huge variance."""
    message = Odometry(header=Header(frame_id=frame), child_frame_id=child_frame)
    fill_unestimated(message.pose.covariance, message.twist.covariance)
    return message


def pose_message(frame: str) -> PoseWithCovarianceStamped:
    """Return a PoseWithCovarianceStamped to be filled repeatedly."""
    message = PoseWithCovarianceStamped(header=Header(frame_id=frame))
    fill_unestimated(message.pose.covariance)
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
