"""Landmarks on the map: measured in the frame of the robot, placed by its estimated pose at the time of measuring."""

from __future__ import annotations

import math
from array import array
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from diffbot_control.ros.messages.landmark_cloud import landmark_points
from diffbot_core.cdr import CdrCursor, CdrError
from diffbot_core.errors import BadMessageError
from diffbot_core.units import S_PER_NS
from diffbot_tools.trajectory import Trajectory, poses_at
from diffbot_tools.view.clock import Clock
from diffbot_tools.view.transforms import BASES, base_name

Array = NDArray[np.float64]

MAX_LANDMARKS = 500
"""on the map: those that were measured most often"""
MAX_MEASUREMENTS = 1_000_000
"""of a bag; later ones are left out"""
MAX_VISITS = 5000
"""most intervals in which landmarks are in view, of one robot; if there are more, short pauses are ignored"""


class Measured(NamedTuple):
    """Points of clouds in the frame of the robot."""

    stamps: NDArray[np.int64]
    """(n,) [ns]"""
    numbers: NDArray[np.int64]
    """(n,) of the landmarks"""
    points: Array
    """(n, 2) [m]"""


class Landmark(NamedTuple):
    """A landmark on the map."""

    number: int
    x: float
    """[m] mean of all measurements"""
    y: float
    in_view: list[float]
    """[s] begin, end, begin, end ... of the intervals in which it was measured"""


def local_points(message: Any) -> list[tuple[int, float, float]]:
    """Return number, x and y [m] of the points of a cloud with a range and a bearing.

    Raises:
        BadMessageError: if the cloud cannot be used, or is not given in the frame of the robot.
    """
    if base_name(message.header.frame_id) not in BASES:
        raise BadMessageError("cloud not in the frame of the robot", message.header.frame_id[:40])
    return [
        (one.number, one.range * math.cos(one.bearing), one.range * math.sin(one.bearing))
        for one in landmark_points(message)
        if math.isfinite(one.var_range + one.var_bearing)
    ]


def read_cloud(data: bytes) -> Any:
    """Return something with the fields of a PointCloud2.

    Raises:
        CdrError: if it is none.
    """
    cursor = CdrCursor(data)
    stamp, frame = cursor.stamp(), cursor.text()
    height, width = cursor.uint32(), cursor.uint32()
    fields = []
    for _ in range(cursor.length()):
        name, offset, datatype = cursor.text(), cursor.uint32(), cursor.byte()
        fields.append(SimpleNamespace(name=name, offset=offset, datatype=datatype, count=cursor.uint32()))
    is_bigendian, point_step, row_step = bool(cursor.byte()), cursor.uint32(), cursor.uint32()
    size = cursor.length()
    begin = cursor.place
    if begin + size > len(data):
        raise CdrError("truncated")
    return SimpleNamespace(
        header=SimpleNamespace(stamp=stamp, frame_id=frame),
        height=height,
        width=width,
        fields=fields,
        is_bigendian=is_bigendian,
        point_step=point_step,
        row_step=row_step,
        data=data[begin : begin + size],
    )


class CloudRows:
    """Collects the clouds of one topic."""

    def __init__(self) -> None:
        """Start empty."""
        self._stamps, self._numbers, self._points = array("q"), array("q"), array("d")
        self.malformed = 0
        """messages that were left out"""

    def add(self, _log_time: int, data: bytes) -> None:
        """Add a message."""
        if len(self._stamps) >= MAX_MEASUREMENTS:
            return
        try:
            message = read_cloud(data)
            points = local_points(message)
        except (CdrError, BadMessageError):
            self.malformed += 1
            return
        for number, x, y in points:
            self._stamps.append(message.header.stamp)
            self._numbers.append(number)
            self._points.extend((x, y))

    def measured(self) -> Measured:
        """Return what was collected."""
        stamps, numbers = (np.array(values, np.int64) for values in (self._stamps, self._numbers))
        return Measured(stamps, numbers, np.array(self._points).reshape(-1, 2))


def placed(measured: Measured, path: Trajectory) -> Array:
    """Return the points (n, 2) [m] in the map; NaN where the path of the robot has no pose within 0.5 s.

    Args:
        measured: points in the frame of the robot.
        path: estimated poses of the robot.
    """
    if not len(measured.stamps):
        return np.empty((0, 2))
    x, y, theta = poses_at(measured.stamps, path).T
    c, s = np.cos(theta), np.sin(theta)
    p, q = measured.points.T
    return np.column_stack((x + c * p - s * q, y + s * p + c * q))


def landmarks_on_map(measured: Measured, path: Trajectory, clock: Clock) -> list[Landmark]:
    """Return the landmarks that were measured, in the order of their numbers."""
    places = placed(measured, path)
    known = np.isfinite(places).all(axis=1)
    stamps, numbers, places = measured.stamps[known], measured.numbers[known], places[known]
    found, counts = np.unique(numbers, return_counts=True)
    shown = np.sort(found[np.argsort(-counts, kind="stable")[:MAX_LANDMARKS]])
    order = np.lexsort((stamps, numbers))
    numbers, places, times = numbers[order], places[order], clock.of_stamps(stamps[order])
    ends = [np.searchsorted(numbers, shown, side) for side in ("left", "right")]
    parts = [slice(*pair) for pair in zip(*(end.tolist() for end in ends), strict=True)]
    pause = _longest_pause(measured.stamps)
    while sum(len(_visits(times[part], pause)) for part in parts) > 2 * MAX_VISITS and pause < math.inf:
        pause *= 2.0
    landmarks = []
    for number, part in zip(shown.tolist(), parts, strict=True):
        x, y = places[part].mean(axis=0).tolist()
        landmarks.append(Landmark(number, x, y, _visits(times[part], pause)))
    return landmarks


def _longest_pause(stamps: NDArray[np.int64]) -> float:
    """Return the time [s] after which a landmark is out of view: two periods of the clouds."""
    periods = np.diff(np.unique(stamps))
    return 2.0 * float(np.median(periods)) * S_PER_NS if len(periods) else 1.0


def _visits(times: Array, pause: float) -> list[float]:
    """Return begin and end of each run of times [s] without a longer pause, which also follows each end."""
    gaps = np.flatnonzero(np.diff(times) > pause)
    begins, ends = times[np.r_[0, gaps + 1]], times[np.r_[gaps, len(times) - 1]] + pause
    visits: list[float] = np.round(np.column_stack((begins, ends)).ravel(), 3).tolist()
    return visits
