"""Poses of other frames brought into ``map``. Free of ROS: who looks up a transform is a :class:`Transforms`."""

from __future__ import annotations

from typing import Any, Protocol

from diffbot_control.ros.messages.fields import check_frame, check_numbers, pose_of, stamp_ns, yaw_of
from diffbot_core.errors import BadMessageError
from diffbot_core.geometry import MAX_COORDINATE, Pose, yaw_of_quaternion

Quaternion = tuple[float, float, float, float]
"""x, y, z, w, of unit length."""


class Transforms(Protocol):
    """Looks up transforms."""

    def lookup(self, target: str, source: str, stamp: int) -> Any:
        """Return the geometry_msgs/Transform that takes coordinates in ``source`` to those in ``target``.

        Args:
            target: frame of the result.
            source: frame of what is to be transformed.
            stamp: [ns] time of the transform; 0: the newest.

        Raises:
            BadMessageError: with the reason, if there is none.
        """


class NoTransforms:
    """Stands in where there is no tf2: every other frame is refused."""

    def lookup(self, target: str, source: str, stamp: int) -> Any:
        """Refuse the frame."""
        raise BadMessageError("wrong frame_id", f"{source[:80]!r}, not {target!r}: other frames need tf2_ros")


NO_TRANSFORMS = NoTransforms()


class LastTransform:
    """Keeps the last transform that was looked up: the poses of a path mostly share frame and time."""

    def __init__(self, transforms: Transforms) -> None:
        """Take what looks up."""
        self._transforms = transforms
        self._last: tuple[tuple[str, str, int], Any] | None = None

    def lookup(self, target: str, source: str, stamp: int) -> Any:
        """Return a transform as :meth:`Transforms.lookup` does."""
        key = target, source, stamp
        if self._last is None or self._last[0] != key:
            self._last = key, self._transforms.lookup(target, source, stamp)
        return self._last[1]


def pose_in_frame(pose: Any, header: Any, frame: str, transforms: Transforms) -> Pose:
    """Return a geometry_msgs/Pose as a planar pose in ``frame``.

    Args:
        pose: the message.
        header: its frame and time; time 0 means now.
        frame: the frame of the result.
        transforms: asked if the pose is in another frame.

    Raises:
        BadMessageError: if the pose is not valid, or there is no transform to ``frame``.
    """
    if header.frame_id == frame:
        return pose_of(pose)
    if not header.frame_id:
        check_frame(header.frame_id, frame)
    yaw_of(pose.orientation)  # refuses what is no rotation
    numbers = pose.position.x, pose.position.y, pose.position.z
    check_numbers(numbers, MAX_COORDINATE, "position")
    return transformed(pose, transforms.lookup(frame, header.frame_id, stamp_ns(header.stamp)))


def transformed(pose: Any, transform: Any) -> Pose:
    """Return a geometry_msgs/Pose taken through a geometry_msgs/Transform, reduced to the plane.

    The transform is spatial, since the frame of a camera or of a fork may be tilted: p' = q p q* + t, and the yaw is
    that of q q_pose.
    """
    q, orientation = _quaternion(transform.rotation), _quaternion(pose.orientation)
    p = pose.position
    x, y, _, _ = _product(_product(q, (p.x, p.y, p.z, 0.0)), _conjugate(q))
    t = transform.translation
    result = Pose(t.x + x, t.y + y, yaw_of_quaternion(*_product(q, orientation)))
    check_numbers(result, MAX_COORDINATE, "transformed pose")
    return result


def _quaternion(message: Any) -> Quaternion:
    return message.x, message.y, message.z, message.w


def _conjugate(q: Quaternion) -> Quaternion:
    return -q[0], -q[1], -q[2], q[3]


def _product(a: Quaternion, b: Quaternion) -> Quaternion:
    """Hamilton's product."""
    ax, ay, az, aw = a
    bx, by, bz, bw = b
    return (
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
        aw * bw - ax * bx - ay * by - az * bz,
    )
