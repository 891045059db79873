"""Transformation of poses and vectors to other frames; this module does not import ROS."""

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
"""x, y, z, w; of unit length"""
Vector = tuple[float, float, float]
_PATIENCE = 2 * NS_PER_S
"""[ns] A transform may be missing for this time after the first message, since static transforms may arrive late."""
_AXES: tuple[Vector, ...] = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)


class Transforms(Protocol):
    """Looks up transforms."""

    @property
    def available(self) -> bool:
        """False if tf2 is not installed, so that no transform can be found."""

    def lookup(self, target: str, source: str, stamp: int) -> Any:
        """Return the geometry_msgs/Transform from frame ``source`` to frame ``target``.

        Args:
            target: frame of the transformed coordinates.
            source: frame of the coordinates to transform.
            stamp: time of the transform [ns]; 0: newest transform.

        Raises:
            BadMessageError: if the transform is not available.
        """


class NoTransforms:
    """Implementation of Transforms without tf2: no transform is available."""

    available = False

    def lookup(self, target: str, source: str, stamp: int) -> Any:
        """Refuse the frame."""
        sentence = f"{source[:80]!r}, not {target!r}: use the frame {target!r}, or install tf2_ros"
        raise BadMessageError("wrong frame_id", sentence)


NO_TRANSFORMS = NoTransforms()


class LastTransform:
    """Caches the last transform, since most lookups repeat the previous one.

    The newest transform (stamp 0) is also cached, so look it up only between frames that are fixed to each other.
    """

    def __init__(self, make: Callable[[], Transforms]) -> None:
        """Store ``make``, which the first lookup calls to start receiving transforms."""
        self._transforms = cache(make)
        self._last: tuple[tuple[str, str, int], Any] | None = None

    @property
    def available(self) -> bool:
        """See :attr:`Transforms.available`."""
        return self._transforms().available

    def lookup(self, target: str, source: str, stamp: int) -> Any:
        """See :meth:`Transforms.lookup`."""
        key = target, source, stamp
        if self._last is None or self._last[0] != key:
            self._last = key, self._transforms().lookup(target, source, stamp)
        return self._last[1]


class Mounting:
    """Orientation of a sensor on the robot. Without a transform, the sensor is assumed to be aligned with the robot."""

    def __init__(self, frame: str, transforms: Transforms) -> None:
        """Store the frame of the robot, and the transforms to the frame of the sensor."""
        self._frame, self._transforms = frame, transforms
        self._since: int | None = None
        """[ns] stamp of the first message without a transform"""
        self.assumed = ""
        """assumption about the mounting for the newest message; empty if its transform is known"""

    def rotation_to(self, source: str, stamp: int) -> Any:
        """Return the rotation from the frame of the robot to ``source``; None if the axes are aligned.

        Raises:
            BadMessageError: if the transform is missing at ``stamp`` [ns] but may still arrive.
        """
        self.assumed = ""
        if source in ("", self._frame):
            return None
        if self._transforms.available:
            try:
                rotation = self._transforms.lookup(source, self._frame, 0).rotation
            except BadMessageError:
                if self._since is None or stamp < self._since:
                    self._since = stamp
                if stamp - self._since < _PATIENCE:
                    raise
            else:
                self._since = None
                return rotation
        self.assumed = (
            f"no transform between {source[:80]!r} and {self._frame!r}: the sensor is used as if it were mounted "
            f"upright and forward; publish a static transform (and install tf2_ros), or set frame_id to {self._frame!r}"
        )
        return None


def pose_in_frame(pose: Any, header: Any, frame: str, transforms: Transforms) -> Pose:
    """Return a geometry_msgs/Pose as a planar pose in ``frame``.

    Args:
        pose: the message.
        header: frame and time of the pose; time 0 means the newest transform.
        frame: frame of the result.
        transforms: used if the pose is in another frame.

    Raises:
        BadMessageError: if the pose is invalid, or the transform to ``frame`` is not available.
    """
    if header.frame_id == frame:
        return pose_of(pose)
    if not header.frame_id:
        check_frame(header.frame_id, frame)
    yaw_of(pose.orientation)  # raises an error for an invalid rotation
    numbers = pose.position.x, pose.position.y, pose.position.z
    check_numbers(numbers, MAX_COORDINATE, "position")
    return transformed(pose, transforms.lookup(frame, header.frame_id, stamp_ns(header.stamp)))


def transformed(pose: Any, transform: Any) -> Pose:
    """Apply a geometry_msgs/Transform to a geometry_msgs/Pose, and return the planar part of the result.

    The transform is spatial, since the frame may be tilted, e.g. the frame of a camera. With rotation q and translation
    t, the position is q p q* + t, and the orientation is q q_pose.
    """
    p, t = pose.position, transform.translation
    x, y, _ = rotated((p.x, p.y, p.z), transform.rotation)
    orientation = _product(_quaternion(transform.rotation), _quaternion(pose.orientation))
    result = Pose(t.x + x, t.y + y, yaw_of_quaternion(*orientation))
    check_numbers(result, MAX_COORDINATE, "transformed pose")
    return result


def yaw_through(orientation: Any, rotation: Any) -> float:
    """Return the yaw of the robot [rad], given the orientation of a sensor and the rotation from robot to sensor."""
    return yaw_of_quaternion(*_product(_quaternion(orientation), _quaternion(rotation)))


class StaticTransforms:
    """Static transforms, as a node receives them on /tf_static."""

    available = True

    def __init__(self) -> None:
        """Start without a transform."""
        self._parents: dict[str, tuple[str, Quaternion, Vector]] = {}

    def add(self, parent: str, child: str, transform: Any) -> None:
        """Store the geometry_msgs/Transform of ``child`` in ``parent``; it replaces an older transform of ``child``."""
        t, q = transform.translation, _quaternion(transform.rotation)
        yaw_of(transform.rotation)  # raises an error for an invalid rotation
        self._parents[child] = parent, q, (t.x, t.y, t.z)

    def lookup(self, target: str, source: str, stamp: int) -> Any:
        """See :meth:`Transforms.lookup`; static transforms are valid for every stamp."""
        (target_root, p, t), (source_root, q, u) = self._to_root(target), self._to_root(source)
        if target_root != source_root:
            raise BadMessageError("no transform", f"{source[:80]!r} to {target!r}: not on /tf_static")
        x, y, z = _rotate((u[0] - t[0], u[1] - t[1], u[2] - t[2]), _conjugate(p))
        q_x, q_y, q_z, q_w = _product(_conjugate(p), q)
        return SimpleNamespace(
            translation=SimpleNamespace(x=x, y=y, z=z), rotation=SimpleNamespace(x=q_x, y=q_y, z=q_z, w=q_w)
        )

    def _to_root(self, frame: str) -> tuple[str, Quaternion, Vector]:
        """Return the topmost known ancestor of a frame, and rotation and translation of the frame in the ancestor."""
        q: Quaternion = (0.0, 0.0, 0.0, 1.0)
        t: Vector = (0.0, 0.0, 0.0)
        for _ in range(len(self._parents)):  # ends even if the frames form a loop
            if frame not in self._parents:
                break
            frame, rotation, (x, y, z) = self._parents[frame]
            a, b, c = _rotate(t, rotation)
            q, t = _product(rotation, q), (x + a, y + b, z + c)
        return frame, q, t


def rotated_covariance(covariance: Any, rotation: Any) -> Array:
    """Rotate the 36 numbers of a pose covariance by a geometry_msgs/Quaternion: J P J^T."""
    J = np.zeros((6, 6))
    J[:3, :3] = J[3:, 3:] = np.column_stack([rotated(axis, rotation) for axis in _AXES])
    P: Array = (J @ np.asarray(covariance, dtype=float).reshape(6, 6) @ J.T).ravel()
    return P


def rotated(vector: Vector, rotation: Any) -> Vector:
    """Return a vector rotated by a geometry_msgs/Quaternion."""
    return _rotate(vector, _quaternion(rotation))


def _rotate(vector: Vector, q: Quaternion) -> Vector:
    """Return q v q*."""
    x, y, z, _ = _product(_product(q, (*vector, 0.0)), _conjugate(q))
    return x, y, z


def _quaternion(message: Any) -> Quaternion:
    return message.x, message.y, message.z, message.w


def _conjugate(q: Quaternion) -> Quaternion:
    return -q[0], -q[1], -q[2], q[3]


def _product(a: Quaternion, b: Quaternion) -> Quaternion:
    """Return the Hamilton product a b."""
    ax, ay, az, aw = a
    bx, by, bz, bw = b
    return (
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
        aw * bw - ax * bx - ay * by - az * bz,
    )
