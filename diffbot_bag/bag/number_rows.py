"""Columns of numbers from the messages of a topic: blocks of float64 as arrays of many messages.

The types that a report needs are few and known, and a generic decoder takes 0.1 to 1 ms a message. Little-endian CDR
only.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from diffbot_core.cdr import HEADER, CdrCursor, CdrError

_BATCH = 4096


def _skip_text(cursor: CdrCursor) -> None:
    cursor.text()


def _skip_two_texts(cursor: CdrCursor) -> None:
    cursor.text()
    cursor.text()


def _skip_nothing(_cursor: CdrCursor) -> None:
    pass


def _skip_dimensions(cursor: CdrCursor) -> None:
    labels, count = _labels_and_count(cursor)
    if len(labels) != count:
        raise CdrError("not one number per label")


class Layout(NamedTuple):
    """A type that ends with a constant number of float64."""

    numbers: int
    skip: Callable[[CdrCursor], None] = _skip_text
    """moves over what stands between the stamp and the numbers"""
    is_stamped: bool = True


LAYOUTS = {
    "nav_msgs/msg/Odometry": Layout(85, _skip_two_texts),
    "geometry_msgs/msg/PoseWithCovarianceStamped": Layout(43),
    "geometry_msgs/msg/PoseStamped": Layout(7),
    "geometry_msgs/msg/TwistStamped": Layout(6),
    "geometry_msgs/msg/Twist": Layout(6, _skip_nothing, False),
}
LABELLED = "std_msgs/msg/Float64MultiArray"


def labels_of(data: bytes) -> list[str]:
    """Return the labels of a Float64MultiArray, one per dimension.

    Raises:
        CdrError: if it is none, or has not one number per label.
    """
    cursor = CdrCursor(data)
    labels, count = _labels_and_count(cursor)
    if len(labels) != count:
        raise CdrError("not one number per label")
    return labels


def labelled_layout(labels: Sequence[str]) -> Layout:
    """Return the layout of a Float64MultiArray with one number per label."""
    return Layout(len(labels), _skip_dimensions, False)


def _labels_and_count(cursor: CdrCursor) -> tuple[list[str], int]:
    labels = []
    for _ in range(cursor.length()):
        labels.append(cursor.text())
        cursor.uint32()
        cursor.uint32()
    cursor.uint32()
    return labels, cursor.length()


class NumberRows:
    """All messages of one topic that have one layout, as columns; read in batches, with constant memory beside them."""

    def __init__(self, layout: Layout, keep: Sequence[int]) -> None:
        """Keep the numbers with these indices, in the order of the type's definition."""
        self._layout, self._keep = layout, list(keep)
        self._pending: dict[tuple[int, bytes], list[tuple[int, bytes]]] = {}
        self._waiting = 0
        self._times: list[NDArray[np.int64]] = []
        self._numbers: list[NDArray[np.float64]] = []
        self.malformed = 0
        """messages that were left out"""

    def add(self, log_time: int, data: bytes) -> None:
        """Add a message with its log time [ns]."""
        # Equal texts before the numbers: one layout.
        key = len(data), data[4 if not self._layout.is_stamped else 12 : -8 * self._layout.numbers]
        self._pending.setdefault(key, []).append((log_time, data))
        self._waiting += 1
        if self._waiting >= _BATCH:
            self._flush()

    def _flush(self) -> None:
        for group in self._pending.values():
            begin = self._numbers_begin(group[0][1])
            good = [(time, data) for time, data in group if data[:4] == HEADER] if begin else []
            self.malformed += len(group) - len(good)
            if not good:
                continue
            block = np.frombuffer(b"".join(data for _, data in good), np.uint8).reshape(len(good), -1)
            numbers = block[:, begin : begin + 8 * self._layout.numbers].copy().view("<f8")
            log_times = np.array([time for time, _ in good], np.int64)
            stamps = log_times
            if self._layout.is_stamped:
                stamps = block[:, 4:8].copy().view("<i4").astype(np.int64)[:, 0] * 10**9
                stamps += block[:, 8:12].copy().view("<u4").astype(np.int64)[:, 0]
            self._times.append(np.column_stack((stamps, log_times)))
            self._numbers.append(numbers[:, self._keep])
        self._pending.clear()
        self._waiting = 0

    def _numbers_begin(self, data: bytes) -> int:
        """Return the index of the first number, 0 if the message is none of this type."""
        try:
            cursor = CdrCursor(data)
            if self._layout.is_stamped:
                cursor.stamp()
            self._layout.skip(cursor)
            begin = cursor.align(8)
        except CdrError:
            return 0
        return begin if len(data) == begin + 8 * self._layout.numbers else 0

    def columns(self) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float64]]:
        """Return stamps (n,) [ns], log times (n,) [ns] and numbers (n, k), in the order of the stamps.

        A type without a stamp has its log time for one.
        """
        self._flush()
        if not self._times:
            return np.empty(0, np.int64), np.empty(0, np.int64), np.empty((0, len(self._keep)))
        # Batches and result together would be most of the memory of a report.
        times = np.concatenate(self._times)
        self._times = [times]
        numbers = np.concatenate(self._numbers)
        self._numbers = [numbers]
        if np.any(np.diff(times[:, 0]) < 0):
            order = np.argsort(times[:, 0], kind="stable")
            times, numbers = times[order], numbers[order]
        return times[:, 0], times[:, 1], numbers
