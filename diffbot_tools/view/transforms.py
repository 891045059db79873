"""The path of a robot from /tf: the transforms from the outermost frame to the robot's, multiplied."""

from __future__ import annotations

from array import array

import numpy as np
from numpy.typing import NDArray

from diffbot_core.cdr import CdrCursor
from diffbot_core.geometry import yaw_of_quaternion

Array = NDArray[np.float64]
BASES = ("base_link", "base_footprint", "base")
MAX_EDGES = 200
"""pairs of frames that are kept; a robot with more joints keeps the first ones"""


def base_name(frame: str) -> str:
    """Return a frame without the robot's prefix, such as ``robot1/``."""
    return frame.rpartition("/")[2]


def is_local(frame: str) -> bool:
    """Return whether a frame moves with the robot or drifts with its odometry, going by its name."""
    return base_name(frame) in (*BASES, "odom")


class TransformRows:
    """Collects the transforms of /tf in the plane."""

    def __init__(self) -> None:
        """Start empty."""
        self._edges: dict[tuple[str, str], tuple[array[int], array[float]]] = {}

    def add(self, data: bytes) -> None:
        """Add a tf2_msgs/TFMessage.

        Raises:
            CdrError: if it is none.
        """
        cursor = CdrCursor(data)
        for _ in range(cursor.length()):
            stamp, parent, child = cursor.stamp(), cursor.text(), cursor.text()
            x, y, _, *quaternion = cursor.doubles(7)
            edge = parent.lstrip("/"), child.lstrip("/")
            if edge not in self._edges and len(self._edges) >= MAX_EDGES:
                continue
            stamps, numbers = self._edges.setdefault(edge, (array("q"), array("d")))
            stamps.append(stamp)
            numbers.extend((x, y, yaw_of_quaternion(*quaternion)))

    def path(self) -> tuple[NDArray[np.int64], Array]:
        """Return stamps (n,) [ns] and poses (n, 3) of the robot in the outermost frame; empty if it has no frame."""
        parents = {child: parent for parent, child in self._edges}
        base = next((name for name in sorted(parents, key=_rank) if _rank(name) < len(BASES)), None)
        if base is None:
            return np.empty(0, np.int64), np.empty((0, 3))
        stamps, poses = self._samples(parents[base], base)
        child, visited = parents[base], {base}
        while child in parents and child not in visited:
            visited.add(child)
            outer_stamps, outer = self._samples(parents[child], child)
            held = np.clip(np.searchsorted(outer_stamps, stamps, "right") - 1, 0, len(outer_stamps) - 1)
            poses, child = _product(outer[held], poses), parents[child]
        return stamps, poses

    def _samples(self, parent: str, child: str) -> tuple[NDArray[np.int64], Array]:
        stamps, numbers = self._edges[parent, child]
        found, poses = np.array(stamps, np.int64), np.array(numbers).reshape(-1, 3)
        order = np.argsort(found, kind="stable")
        return found[order], poses[order]


def _rank(frame: str) -> int:
    last = frame.rpartition("/")[2]
    return BASES.index(last) if last in BASES else len(BASES)


def _product(outer: Array, inner: Array) -> Array:
    c, s = np.cos(outer[:, 2]), np.sin(outer[:, 2])
    x = outer[:, 0] + c * inner[:, 0] - s * inner[:, 1]
    y = outer[:, 1] + s * inner[:, 0] + c * inner[:, 1]
    turned = outer[:, 2] + inner[:, 2]
    return np.column_stack((x, y, np.arctan2(np.sin(turned), np.cos(turned))))
