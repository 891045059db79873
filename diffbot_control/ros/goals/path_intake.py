"""Paths taken in slices: the controller answers poses while it reads a long path."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from itertools import islice
from typing import Any

from diffbot_core.errors import BadMessageError
from diffbot_core.geometry import Pose
from diffbot_core.ros.node import DiffbotNode

TOPIC = "path"
SLICE = 100
"""poses that are read at once, in about 1.5 ms; a path that is no longer is accepted at once"""
PAUSE = 0.005
"""[s] from one slice to the next, in which the executor handles other messages"""


class PathIntake:
    """Reads the newest path; a newer goal, a cancellation or a newer path ends the reading."""

    def __init__(self, node: DiffbotNode[Any], accept: Callable[[list[Pose]], None]) -> None:
        """Create the timer of the slices; ``accept`` receives the goals of a path that is good to its end."""
        self._node, self._accept = node, accept
        self._rest: Iterator[Pose] | None = None
        self._goals: list[Pose] = []
        self._timer = node.create_timer(PAUSE, self._read_on, clock=node.steady_clock)
        self._timer.cancel()

    def start(self, poses: Iterator[Pose]) -> None:
        """Begin to read a path.

        Raises:
            BadMessageError: if one of the poses of the first slice cannot be used; the present goal stays.
        """
        self.drop()
        self._goals, self._rest = [], poses
        if not self._read_slice():
            self._timer.reset()

    def drop(self) -> bool:
        """End the reading; return whether a path was being read."""
        was_reading = self._rest is not None
        self._timer.cancel()
        self._rest, self._goals = None, []
        return was_reading

    def _read_slice(self) -> bool:
        """Read on; return whether the path has ended."""
        if self._rest is None:
            return True
        try:
            found = list(islice(self._rest, SLICE))
        except BadMessageError:
            self.drop()
            raise
        self._goals += found
        if len(found) == SLICE:
            return False
        goals = self._goals
        self.drop()
        self._accept(goals)
        return True

    def _read_on(self) -> None:
        """Read a slice outside the subscription, whose guard has counted the path as received."""
        try:
            if self._read_slice():
                self._timer.cancel()
        except BadMessageError as error:
            if self._node.health.drop(TOPIC, error.kind):
                self._node.get_logger().warning(f"{TOPIC}: message dropped: {error} (logged once; see /diagnostics)")
