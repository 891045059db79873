"""Transformation of poses and vectors to other frames. Free of ROS: a :class:`Transforms` looks up the transforms."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from types import SimpleNamespace
from typing import Any, Protocol

import numpy as np

from diffbot_control.filter.models import Array
from diffbot_control.ros.messages.fields import check_frame, check_numbers, pose_of, stamp_ns, yaw_of
from diffbot_core.errors import BadMessageError
from diffbot_core.geometry import MAX_COORDINATE, Pose, yaw_of_quaternion
from diffbot_core.stamps import NS_PER_S

Quaternion = tuple[float, float, float, float]
"""x, y, z, w, of unit length."""
Vector = tuple[float, float, float]
_PATIENCE = 2 * NS_PER_S
"""[ns] for which the first transform may be missing: static transforms are received shortly after the start"""
_AXES: tuple[Vector, ...] = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)


class Transforms(Protocol):
    """Looks up transforms."""

    @property
    def available(self) -> bool:
        """False: there is no tf2, and nothing will be found."""

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
    """Replacement where tf2 is not installed: every other frame is refused."""

    available = False

    def lookup(self, target: str, source: str, stamp: int) -> Any:
        """Refuse the frame."""
        raise BadMessageError("wrong frame_id", f"{source[:80]!r}, not {target!r}: other frames need tf2_ros")


NO_TRANSFORMS = NoTransforms()


class LastTransform:
    """Keeps the last transform: the poses of a path mostly share frame and time, and an Imu is fixed to the robot."""

    def __init__(self, make: Callable[[], Transforms]) -> None:
        """Store the function that begins to receive transforms; the first lookup calls it."""
        self._transforms = cache(make)
        self._last: tuple[tuple[str, str, int], Any] | None = None

    @property
    def available(self) -> bool:
        """False: there is no tf2, and nothing will be found."""
        return self._transforms().available

    def lookup(self, target: str, source: str, stamp: int) -> Any:
        """Return a transform as :meth:`Transforms.lookup` does."""
        key = target, source, stamp
        if self._last is None or self._last[0] != key:
            self._last = key, self._transforms().lookup(target, source, stamp)
        return self._last[1]


class Mounting:
    """Orientation of a sensor on the robot: that of the robot's own axes, unless a transform is known."""

    def __init__(self, frame: str, transforms: Transforms) -> None:
        """Store the frame of the robot, and the transforms to the frame of the sensor."""
        self._frame, self._transforms = frame, transforms
        self._since: int | None = None
        self.assumed = ""
        """the assumption about the newest message, if no transform is known"""

    def of(self, source: str, stamp: int) -> Any:
        """Return the rotation that takes vectors of the robot's frame to ``source``; None if the axes are the same.

        Raises:
            BadMessageError: if there is no transform at ``stamp`` [ns], but one may still be received.
        """
        self.assumed = ""
        if source in ("", self._frame):
            return None
        if self._transforms.available:
            try:
                found = self._transforms.lookup(source, self._frame, 0).rotation
            except BadMessageError:
                if self._since is None or stamp < self._since:
                    self._since = stamp
                if stamp - self._since < _PATIENCE:
                    raise
            else:
                self._since = None
                return found
        self.assumed = (
            f"no transform between {source[:80]!r} and {self._frame!r}: used as if it were mounted upright and "
            "forward; publish a static transform (and install tf2_ros), or set its frame_id"
        )
        return None


def pose_in_frame(pose: Any, header: Any, frame: str, transforms: Transforms) -> Pose:
    """Return a geometry_msgs/Pose as a planar pose in ``frame``.

    Args:
        pose: the message.
        header: its frame and time; time 0 means now.
        frame: the frame of the result.
        transforms: used if the pose is in another frame.

    Raises:
        BadMessageError: if the pose is not valid, or there is no transform to ``frame``.
    """
    if header.frame_id == frame:
        return pose_of(pose)
    if not header.frame_id:
        check_frame(header.frame_id, frame)
    yaw_of(pose.orientation)  # refuses an invalid rotation
    numbers = pose.position.x, pose.position.y, pose.position.z
    check_numbers(numbers, MAX_COORDINATE, "position")
    return transformed(pose, transforms.lookup(frame, header.frame_id, stamp_ns(header.stamp)))


def transformed(pose: Any, transform: Any) -> Pose:
    """Apply a geometry_msgs/Transform to a geometry_msgs/Pose, and return the planar part.

    The transform is spatial, since the frame of a camera or of a fork may be tilted: p' = q p q* + t, and the yaw is
    that of q q_pose.
    """
    p, t = pose.position, transform.translation
    x, y, _ = rotated((p.x, p.y, p.z), transform.rotation)
    orientation = _product(_quaternion(transform.rotation), _quaternion(pose.orientation))
    result = Pose(t.x + x, t.y + y, yaw_of_quaternion(*orientation))
    check_numbers(result, MAX_COORDINATE, "transformed pose")
    return result


def yaw_through(orientation: Any, rotation: Any) -> float:
    """Return the yaw [rad] of the robot, given the orientation of a sensor and the rotation from robot to sensor."""
    return yaw_of_quaternion(*_product(_quaternion(orientation), _quaternion(rotation)))


class StaticTransforms:
    """Static transforms, each from a frame to its parent, as a node receives them on /tf_static."""

    available = True

    def __init__(self) -> None:
        """Start without a transform."""
        self._parents: dict[str, tuple[str, Quaternion, Vector]] = {}

    def add(self, parent: str, child: str, transform: Any) -> None:
        """Store a geometry_msgs/Transform of ``child`` in ``parent``; a newer one replaces it."""
        t, q = transform.translation, _quaternion(transform.rotation)
        yaw_of(transform.rotation)  # refuses an invalid rotation
        self._parents[child] = parent, q, (t.x, t.y, t.z)

    def lookup(self, target: str, source: str, stamp: int) -> Any:
        """Return a transform as :meth:`Transforms.lookup` does; it is valid for every stamp."""
        (of_target, p, t), (of_source, q, u) = self._to_root(target), self._to_root(source)
        if of_target != of_source:
            raise BadMessageError("no transform", f"{source[:80]!r} to {target!r}: not on /tf_static")
        moved = _turned((u[0] - t[0], u[1] - t[1], u[2] - t[2]), _conjugate(p))
        turned = _product(_conjugate(p), q)
        return SimpleNamespace(
            translation=SimpleNamespace(**dict(zip("xyz", moved, strict=True))),
            rotation=SimpleNamespace(**dict(zip("xyzw", turned, strict=True))),
        )

    def _to_root(self, frame: str) -> tuple[str, Quaternion, Vector]:
        """Return the last known ancestor of a frame, and rotation and translation of the frame in it."""
        q: Quaternion = (0.0, 0.0, 0.0, 1.0)
        t: Vector = (0.0, 0.0, 0.0)
        for _ in range(len(self._parents)):  # also ends if the frames form a loop
            if frame not in self._parents:
                break
            frame, turn, (x, y, z) = self._parents[frame]
            a, b, c = _turned(t, turn)
            q, t = _product(turn, q), (x + a, y + b, z + c)
        return frame, q, t


def rotated_covariance(covariance: Any, rotation: Any) -> Array:
    """Return the 36 numbers of a pose covariance in axes that a geometry_msgs/Quaternion rotates: J P J^T."""
    J = np.zeros((6, 6))
    J[:3, :3] = J[3:, 3:] = np.column_stack([rotated(axis, rotation) for axis in _AXES])
    P: Array = (J @ np.asarray(covariance, dtype=float).reshape(6, 6) @ J.T).ravel()
    return P


def rotated(vector: Vector, rotation: Any) -> Vector:
    """Return a vector turned by a geometry_msgs/Quaternion."""
    return _turned(vector, _quaternion(rotation))


def _turned(vector: Vector, q: Quaternion) -> Vector:
    """Return q v q*."""
    x, y, z, _ = _product(_product(q, (*vector, 0.0)), _conjugate(q))
    return x, y, z


def _quaternion(message: Any) -> Quaternion:
    return message.x, message.y, message.z, message.w


def _conjugate(q: Quaternion) -> Quaternion:
    return -q[0], -q[1], -q[2], q[3]


def _product(a: Quaternion, b: Quaternion) -> Quaternion:
    """Return Hamilton's product a b."""
    ax, ay, az, aw = a
    bx, by, bz, bw = b
    return (
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
        aw * bw - ax * bx - ay * by - az * bz,
    )
