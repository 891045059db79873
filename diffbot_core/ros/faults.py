"""What a callback raises: malformed input that rclpy refuses, and everything unforeseen; recorded once each.

An exception that leaves a callback ends rclpy's spinning, and its EventsExecutor calls no further callback after one.
So a node contains what its callbacks raise, those that rclpy itself registers (parameter services, /clock) included.
"""

from __future__ import annotations

import traceback
from types import TracebackType
from typing import Any

from rcl_interfaces.msg import SetParametersResult

from diffbot_core.errors import BadMessageError
from diffbot_core.schema import MAX_LENGTH

MAX_ENTRIES = 1000
"""names, prefixes or parameters in one call of a parameter service"""
_PASSED_THROUGH = ("diffbot_core.ros.base_node", "diffbot_core.ros.faults", "diffbot_core.ros.node")
"""Modules of this project that a call to rclpy passes through."""


class FaultRecord:
    """The internal errors of one node; their number is bounded by that of the places in the code."""

    def __init__(self) -> None:
        """Start without one."""
        self.newest = ""
        """the newest one in a line; empty if there was none"""
        self.trace = ""
        """its traceback"""
        self._known: set[tuple[str, str, int]] = set()

    def add(self, error: Exception, where: str) -> bool:
        """Record an error of the callback of ``where``; return True if it is the first of its kind and place."""
        self.newest = f"internal error in {where}: {one_line(error)}"
        self.trace = "".join(traceback.format_exception(error))
        place = traceback.extract_tb(error.__traceback__)[-1:]
        key = (type(error).__name__, place[0].filename, place[0].lineno or 0) if place else (where, "", 0)
        is_new = key not in self._known
        self._known.add(key)
        return is_new


def is_refusal(error: Exception) -> bool:
    """Return True if it is an answer to input that is malformed: a BadMessageError, or raised by rclpy alone."""
    if isinstance(error, BadMessageError):
        return True
    trace: TracebackType | None = error.__traceback__
    while trace is not None:
        module = str(trace.tb_frame.f_globals.get("__name__", ""))
        if module.startswith("diffbot_") and module not in _PASSED_THROUGH:
            return False
        trace = trace.tb_next
    return True


def check_size(request: Any) -> None:
    """Check that a call of a parameter service can be handled at once, before anything of it is looked at.

    Raises:
        BadMessageError: naming the field, its length and the bound.
    """
    for field in ("parameters", "names", "prefixes"):
        entries = getattr(request, field, ())
        _check_length(field, entries, MAX_ENTRIES)
        for entry in entries:
            _check_length("a name", getattr(entry, "name", entry), MAX_LENGTH)
            value = getattr(entry, "value", None)
            for kind in value.get_fields_and_field_types() if value is not None else ():
                if hasattr(part := getattr(value, kind), "__len__"):
                    _check_length(kind, part, MAX_LENGTH)


def _check_length(field: str, found: Any, bound: int) -> None:
    if len(found) > bound:
        raise BadMessageError("too long", f"{field} of length {len(found)}: must be <= {bound}")


def fill_refusal(request: Any, response: Any, reason: str) -> Any:
    """Return the response of a failed service call: with ``reason`` where its type has a place for one."""
    if hasattr(response, "results") and hasattr(request, "parameters"):
        missing = min(len(request.parameters), MAX_ENTRIES) - len(response.results)
        response.results.extend(SetParametersResult(successful=False, reason=reason) for _ in range(missing))
    elif hasattr(response, "result") and isinstance(response.result, SetParametersResult):
        response.result = SetParametersResult(successful=False, reason=reason)
    elif hasattr(response, "success") and hasattr(response, "message"):
        response.success, response.message = False, reason
    return response


def one_line(error: BaseException) -> str:
    """Return type and text of an error in one line."""
    return f"{type(error).__name__}: {' '.join(str(error).split())}"
