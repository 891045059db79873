"""What makes a law: the interface by which nodes, campaigns and benchmarks call one.

A law is a class or a module with the attributes of :class:`Law`. Its functions are pure: floats and named tuples in and
out, no attribute of an object, so that they compile where numba can.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol

from diffbot_control.law.controller import Report
from diffbot_core.geometry import Pose
from diffbot_core.kinematics import Twist
from diffbot_core.uncertainty import Estimate


class Memory(Protocol):
    """What one step of a law passes to the next: a named tuple of the law's own, with one field of a fixed meaning."""

    @property
    def reached(self) -> bool:
        """True once the law reports the goal as reached; False for ever if it reports nothing."""


class Law(Protocol):
    """A law that drives to a goal pose."""

    name: str
    """one word, as in tables and file names"""
    Config: type[Any]
    """a configuration type (:mod:`diffbot_core.schema`); a field ``data_sheet: DataSheet`` holds limits and latency"""
    new_memory: Callable[[Any], Any]
    """new_memory(config): the memory at rest with a new goal"""
    step: Callable[[Any, Estimate, Pose, float, Any], tuple[Any, Twist, Report]]
    """step(memory, estimate, goal, dt, config) -> memory, command, report; ``dt`` [s] since the last step, 0 at first"""
