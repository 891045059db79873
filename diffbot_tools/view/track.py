"""Times of the page, the newest poses of a robot by their stamps, and the pose of a robot from /tf."""

from __future__ import annotations

from collections import deque
from typing import Any, NamedTuple

from diffbot_control.ros.messages.fields import stamp_ns
from diffbot_core.errors import BadMessageError
from diffbot_core.geometry import MAX_COORDINATE, Pose, out_of_frame, wrap_angle, yaw_of_quaternion
from diffbot_core.stamps import S_PER_NS

BASES = ("base_link", "base_footprint", "base")
_MAX_POSES = 500
"""Number of poses that are kept: 10 s at 50 Hz."""
_MAX_GAP = 500_000_000
"""[ns] Longest gap between two poses that is interpolated."""
_MAX_EDGES = 200
"""Number of transforms that are kept."""


class PageClock:
    """Converts stamps to times of the page. Time 0 is the first stamp or a given stamp."""

    def __init__(self, origin: int | None = None) -> None:
        """Set time 0 to the stamp ``origin`` [ns]; None: to the first stamp that is passed to :meth:`of`."""
        self.origin = origin

    def of(self, stamp: int) -> float:
        """Return the time [s] of a stamp [ns]."""
        if self.origin is None:
            self.origin = stamp
        return (stamp - self.origin) * S_PER_NS


class Stamped(NamedTuple):
    """A pose and its stamp [ns]."""

    stamp: int
    pose: Pose


class Track:
    """The newest poses, in the order of their stamps."""

    def __init__(self) -> None:
        """Start empty."""
        self._poses: deque[Stamped] = deque(maxlen=_MAX_POSES)

    def add(self, stamp: int, pose: Pose) -> bool:
        """Append a pose. Return True if a new run starts, because the stamp [ns] is before the last stamp."""
        is_new_run = bool(self._poses) and stamp < self._poses[-1].stamp
        if is_new_run:
            self._poses.clear()
        self._poses.append(Stamped(stamp, pose))
        return is_new_run

    @property
    def end(self) -> int:
        """The newest stamp [ns]; -1 without a pose."""
        return self._poses[-1].stamp if self._poses else -1

    def at(self, stamp: int) -> Pose | None:
        """Return the interpolated pose at a time [ns]; None before the first pose, after the last pose and in gaps."""
        after = None
        for before in reversed(self._poses):
            if before.stamp > stamp:
                after = before
                continue
            if before.stamp == stamp:
                return before.pose
            if after is None or after.stamp - before.stamp > _MAX_GAP:
                return None
            share = (stamp - before.stamp) / (after.stamp - before.stamp)
            (x, y, theta), (x1, y1, theta1) = before.pose, after.pose
            turned = wrap_angle(theta + share * wrap_angle(theta1 - theta))
            return Pose(x + share * (x1 - x), y + share * (y1 - y), turned)
        return None


class TransformTree:
    """The newest transforms on /tf, projected to the plane."""

    def __init__(self) -> None:
        """Start empty."""
        self._edges: dict[str, tuple[str, Pose]] = {}
        """parent and transform by child"""

    def add(self, message: Any) -> list[Stamped]:
        """Process a tf2_msgs/TFMessage; return the new pose of the robot in the root frame, if there is one.

        Raises:
            BadMessageError: if a stamp is not normalised or a transform is out of range.
        """
        news: dict[str, int] = {}
        for one in message.transforms:
            parent, child = one.header.frame_id.lstrip("/"), one.child_frame_id.lstrip("/")
            place, turn = one.transform.translation, one.transform.rotation
            pose = Pose(place.x, place.y, yaw_of_quaternion(turn.x, turn.y, turn.z, turn.w))
            if not max(map(abs, pose)) <= MAX_COORDINATE:
                raise BadMessageError("transform out of range")
            if child in self._edges or len(self._edges) < _MAX_EDGES:
                self._edges[child] = parent, pose
                news[child] = stamp_ns(one.header.stamp)
        base = next((name for short in BASES for name in self._edges if base_name(name) == short), None)
        return [Stamped(news[base], self._pose_of(base))] if base in news else []

    def _pose_of(self, base: str) -> Pose:
        frame, pose = self._edges[base]
        visited = {base}
        while frame in self._edges and frame not in visited:
            visited.add(frame)
            frame, outer = self._edges[frame]
            pose = out_of_frame(pose, outer)
        return pose


def base_name(frame: str) -> str:
    """Return a frame without the robot's prefix, such as ``robot1/``."""
    return frame.rpartition("/")[2]
