"""The result of a run: how each goal ended, in figures and words; the health of filter, recording and nodes."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from math import degrees
from typing import Any

import numpy as np

from diffbot_control.goals.states import NOT_AT_GOAL
from diffbot_control.law.configuration import ControllerConfig
from diffbot_core.kinematics import WheelGeometry
from diffbot_tools.metrics import GoalMetrics, goal_metrics
from diffbot_tools.view.bag_tables import Timed
from diffbot_tools.view.causes import causes
from diffbot_tools.view.clock import Clock, Columns
from diffbot_tools.view.events import ERROR, OK, WARNING, Event
from diffbot_tools.view.goal_ends import PASSED, GoalEnd, ends_of
from diffbot_tools.view.goals import GoalSent
from diffbot_tools.view.texts import controller_state, filter_state

NEES_SHARE = 0.9
"""of the time below the 95 % bound from which on a filter counts as consistent; the errors are correlated in time"""
_ROUNDING = 1e-6
_LIMITS = (("v", "m/s"), ("omega", "rad/s"))
_SLACK = 0.5
"""of a period, between the stamps by which a controller accelerates and the times at which commands were recorded"""
_MAX_FAULTS = 3
MAX_STATES = 5000
"""of a robot in the page; later ones are left out"""
Line = tuple[int, str]
"""Level and text."""


def length_text(metres: float) -> str:
    """Return a length in words: centimetres below one metre; the page does the same in words.js."""
    return f"{100.0 * metres:.1f} cm" if metres < 0.995 else f"{metres:.2f} m"


def goal_rows(
    curves: Mapping[str, Columns],
    goals: Sequence[GoalSent],
    events: Sequence[Event],
    config: ControllerConfig,
    wheels: WheelGeometry | None = None,
) -> list[dict[str, Any]]:
    """Return a row per goal: how it ended, and figures of the true (else the estimated) path, both also in words.

    A goal that was reached before the recording has no row. The path of a goal that was reached ends with its answer,
    that of others with the next goal. Why a goal was missed is named as far as the curves tell: see causes.py.
    """
    goals = [goal for goal in goals if not goal.is_earlier]
    columns = curves.get("truth", curves.get("estimate"))
    rows = []
    for index, (goal, goal_end) in enumerate(zip(goals, ends_of(goals, events), strict=True)):
        time, pose, (end, ended, _) = goal.time, goal.pose, goal_end
        following = goals[index + 1].time if index + 1 < len(goals) else math.inf
        row: dict[str, Any] = {"goal": list(pose), "time": time, "end": end, "ended": ended}
        lines: list[Line] = []
        is_off = False
        # What comes after the answer, such as a reset of the simulation, is not the drive's.
        until = ended if ended is not None and end.startswith("reached") else following
        if columns is not None and (part := (columns["t"] >= time) & (columns["t"] <= until)).any():
            poses = np.column_stack([columns[name][part] for name in ("x", "y", "theta")])
            xy, yaw = config.tolerance.xy_goal_tolerance, config.tolerance.yaw_goal_tolerance
            found = goal_metrics(columns["t"][part], poses, pose, xy, yaw)
            row |= {
                "position_error": found.position_error,
                "heading_error": found.heading_error,
                "settled": None if math.isnan(found.settling_time) else found.settling_time,
                "path": found.path_length,
                "direct": found.direct_distance,
            }
            is_off = end.startswith("reached") and (found.position_error > xy or found.heading_error > yaw)
            lines += _figures(found, "True" if "truth" in curves else "Estimated", is_off)
        if "law" in curves and "command" in curves:
            lines += _limits(curves["command"], time, following if ended is None else ended, config)
        verdict = _verdict(goal_end, math.isinf(following), is_off)
        if verdict[0] != OK:
            last = min(following, max(float(one["t"][-1]) for one in curves.values()))
            lines = [*causes(curves, time, last if ended is None else ended, config, wheels), *lines]
        rows.append(row | {"level": verdict[0], "verdict": verdict[1], "lines": lines})
    return rows


def _verdict(end: GoalEnd, is_last: bool, is_off: bool) -> Line:
    words = end.words.partition(" [")[0].replace("not reached: not reached", "not reached")
    after = f"{max(end.elapsed, 0.0):.1f} s"
    if words.startswith("reached"):
        return (ERROR, f"Reported reached in {after}, but off the goal") if is_off else (OK, f"Reached in {after}")
    if words.startswith(("replaced", "cancelled", PASSED)):
        return OK, f"{words.capitalize()} after {after}"
    if words:
        return ERROR, f"{words[:1].upper()}{words[1:]} (after {after})"
    return WARNING, "No answer: the recording ends before" if is_last else "No answer in the recording"


def _figures(found: GoalMetrics, whose: str, is_off: bool) -> list[Line]:
    error = f"{whose} error {length_text(found.position_error)}, {degrees(found.heading_error):.1f} deg"
    path = f"Path {found.path_length:.2f} m, straight line {found.direct_distance:.2f} m"
    return [(ERROR if is_off else OK, error), (OK, path)]


def _limits(command: Columns, begin: float, end: float, config: ControllerConfig) -> list[Line]:
    """Return whether the commands of an interval kept the limits of speeds and accelerations; nothing without any."""
    part = (command["t"] >= begin) & (command["t"] <= end)
    sheet, found, is_kept = config.data_sheet, [], True
    # Without a pose the robot is stopped at once: a step onto zero keeps every limit.
    is_moving = ((command["v"] != 0.0) | (command["omega"] != 0.0))[part][1:]
    gaps = np.diff(command["t"][part])
    period = float(np.median(gaps[is_moving])) if is_moving.any() else math.nan
    for (name, unit), limit, rate_limit in zip(
        _LIMITS, (sheet.v_max, sheet.omega_max), (sheet.a_max, sheet.omega_dot_max), strict=True
    ):
        values = command[name][part]
        speeds = np.abs(values[np.isfinite(values)])
        if len(speeds) and math.isfinite(limit):
            is_kept = is_kept and float(speeds.max()) <= limit * (1.0 + _ROUNDING)
            found.append(f"{speeds.max():.2f} of {limit:.2f} {unit}")
        steps = np.abs(np.diff(values))
        joined = np.isfinite(steps) & is_moving
        if joined.any() and math.isfinite(rate_limit):
            # A late recorder shortens a gap, but not the steps.
            times, steps = np.maximum(gaps[joined], period), steps[joined]
            within = bool((steps <= rate_limit * (times + _SLACK * period)).all())
            is_kept = is_kept and within
            fastest = float((steps / times).max())
            found.append(f"{min(fastest, rate_limit) if within else fastest:.2f} of {rate_limit:.2f} {unit}^2")
    if not found:
        return []
    return [(OK if is_kept else ERROR, f"{'Limits kept' if is_kept else 'BEYOND LIMITS'}: {', '.join(found)}")]


def health_lines(
    curves: Mapping[str, Columns], events: Sequence[Event], nees_bound: float, lost: int | None, is_cut_off: bool
) -> list[Line]:
    """Return whether the filter is consistent, what the recording lacks, and the faults; each with its level.

    Args:
        curves: of the robot.
        events: of the robot.
        nees_bound: upper 95 % bound of the NEES.
        lost: messages that the recorder lost; None if it does not say.
        is_cut_off: the bag was not closed.
    """
    lines = [line for line in (_consistency(curves, nees_bound),) if line]
    if is_cut_off:
        lines.append((WARNING, "recording cut off: the bag was not closed"))
    if lost is not None:
        lines.append((WARNING, f"{lost} messages lost") if lost else (OK, "no message lost"))
    # A state and the diagnosis of it have the same words, with other signs between them.
    found = {"".join(filter(str.isalnum, one.text)): one for one in reversed(_run_of(events)) if _is_fault(one)}
    faults = sorted(found.values(), key=lambda one: (-one.level, one.time))
    words = [one.text for one in faults]
    more = f" and {len(words) - _MAX_FAULTS} more" if len(words) > _MAX_FAULTS else ""
    text = f"faults: {'; '.join(words[:_MAX_FAULTS])}{more}" if words else "no fault reported"
    return [*lines, (faults[0].level if faults else OK, text)]


def _run_of(events: Sequence[Event]) -> Sequence[Event]:
    """Return the events without warnings of nodes that start, before the first goal, and that end one by one.

    They end when the controller has become inactive for good.
    """
    last = max(
        (at for at, one in enumerate(events) if one.kind == "state" and one.text.startswith("controller: ")), default=0
    )
    run = events[:last] if last and events[last].text == "controller: inactive" else events
    first = next((at for at, one in enumerate(run) if one.kind == "goal"), 0)
    return [*(one for one in run[:first] if one.level >= ERROR), *run[first:]]


def _is_fault(event: Event) -> bool:
    """True for faults, relocations and states that are errors, but for the end of a goal, which its card tells."""
    is_state = event.kind == "state" and event.level >= ERROR
    return (is_state or event.kind in ("fault", "relocation")) and f": {NOT_AT_GOAL}" not in event.text


def _consistency(curves: Mapping[str, Columns], nees_bound: float) -> Line | None:
    nees = curves["error"]["nees"] if "error" in curves else np.empty(0)
    nees = nees[np.isfinite(nees)]
    if len(nees):
        share = float(np.mean(nees <= nees_bound))
        what = f"NEES below its 95 % bound {100.0 * share:.0f} % of the time"
        return (OK, f"filter consistent: {what}") if share >= NEES_SHARE else (ERROR, f"filter overconfident: {what}")
    if "filter" not in curves:
        return None
    values = curves["filter"]
    known = np.isfinite(values["nis"]) & np.isfinite(values["nis_high"])
    if not known.any():
        return None
    share = float(np.mean(values["nis"][known] <= values["nis_high"][known]))
    what = f"NIS below its bound {100.0 * share:.0f} % of the time"
    return (OK, f"filter consistent: {what}") if share >= NEES_SHARE else (WARNING, f"filter overconfident: {what}")


def state_rows(texts: Mapping[str, Sequence[Timed]], clock: Clock) -> list[tuple[float, dict[str, Any]]]:
    """Return time [s] and state of the controller and the filter whenever it changed, at most MAX_STATES times."""
    readers = {"controller": controller_state, "filter": filter_state}
    found = [(clock.of_log_time(at), readers[role](status)) for role in readers for at, status in texts.get(role, [])]
    state: dict[str, Any] = {}
    rows = []
    for time, news in sorted(found, key=lambda one: one[0]):
        if (after := state | news) != state and "text" in after:
            rows.append((time, after))
        state = after
    return rows[:MAX_STATES]
