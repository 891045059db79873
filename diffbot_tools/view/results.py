"""Results of a recording: how each goal ended, in figures and in words, and the health of filter, recording and nodes.

``diffbot demo``, its table and the report use the same definitions. The error of a goal is the error of the pose at the
answer of the controller. The time of a goal is the time from its acceptance to the answer.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from math import degrees
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from diffbot_control.goals.record import CANCELLED, REACHED, REPLACED
from diffbot_control.goals.states import NOT_AT_GOAL
from diffbot_control.law.configuration import SwitchingConfig
from diffbot_core.errors import DiffbotError
from diffbot_core.geometry import Pose, into_frame
from diffbot_core.kinematics import WheelGeometry
from diffbot_tools.view.causes import causes
from diffbot_tools.view.columns import Columns
from diffbot_tools.view.constants import NEES_BOUNDS
from diffbot_tools.view.events import Event
from diffbot_tools.view.goal_list import PASSED, Goal
from diffbot_tools.view.texts import ERROR, OK, WARNING
from diffbot_tools.view.words import Words, length_text

NEUTRAL = -1
"""Level of a goal that was neither reached nor missed: it was cancelled, replaced or passed."""
TRUSTED_SHARE = 0.9
"""Smallest share of the time below the 95 % bound of a trustworthy filter, whose errors are correlated in time."""
_ROUNDING = 1e-6
_LIMITS = (("v", "m/s"), ("omega", "rad/s"))
_SLACK = 0.5
"""Difference between the stamps by which a controller accelerates and the times of its recorded commands [periods]."""
_MAX_FAULTS = 3
_START = 2.0
"""[s] after the first goal in which warnings are ignored, since nodes still start"""


class GoalOutcome(NamedTuple):
    """How a goal ended.

    The figures are about the drive from the acceptance of the goal to its answer. They are those of the true poses if
    the recording has them, else those of the estimated poses.
    """

    goal: Pose
    """[m, m, rad] in the map"""
    accepted: float
    """[s] when the controller accepted the goal, since the first pose of the recording"""
    end: str = ""
    """one of diffbot_control.goals.record.ENDS, or PASSED; empty: the recording has no answer"""
    reason: str = ""
    """of the end; may be empty"""
    source: str = ""
    """who sent the goal: a topic, an action or a request"""
    ended: float = math.nan
    """[s] when it was answered, since the first pose of the recording; nan without an answer"""
    time: float = math.nan
    """[s] from the acceptance to the answer, by the controller; nan without an answer"""
    position_error: float = math.nan
    """[m] distance from the goal at the answer; without an answer, at the end of the drive"""
    heading_error: float = math.nan
    """[rad] at the same time, not negative"""
    is_true: bool = False
    """the figures are those of the true poses; else of the estimated poses"""
    path_length: float = math.nan
    """[m] travelled, forwards and backwards"""
    direct_distance: float = math.nan
    """[m] from the pose at the acceptance to the goal"""
    revolutions: float = math.nan
    """turns in both directions; 1 is a full turn"""


def goal_results(bag: Path, namespace: str = "") -> list[GoalOutcome]:
    """Return how each goal of a robot ended, in the order in which the goals were accepted.

    Args:
        bag: folder or .mcap file.
        namespace: of the robot, such as ``/robot1``; empty: the robot without one, or the only robot of the bag.

    Raises:
        DiffbotError: if the bag cannot be read, or has no pose of that robot.
    """
    # bag_source imports this module.
    from diffbot_tools.view.bag_source import read_bag  # noqa: PLC0415

    robots = read_bag(bag).robots
    name = namespace.strip("/") or "robot"
    chosen = [one for one in robots if one.name == name] or (robots if not namespace and len(robots) == 1 else [])
    if not chosen:
        raise DiffbotError(f"{bag}: no robot '{name}' in it: {', '.join(one.name for one in robots)}")
    return chosen[0].outcomes


def outcomes_of(goals: Sequence[Goal], curves: Mapping[str, Columns]) -> list[GoalOutcome]:
    """Return how each goal ended, without the goal that was reached before the recording.

    Args:
        goals: in the order of time.
        curves: of the robot.
    """
    driven = [goal for goal in goals if not goal.is_earlier]
    path = curves.get("truth", curves.get("estimate"))
    found = []
    for index, goal in enumerate(driven):
        following = driven[index + 1].time if index + 1 < len(driven) else math.inf
        until = following if math.isnan(goal.ended) else goal.ended
        passed = goal.ended - goal.time
        time = passed if math.isnan(goal.elapsed) else goal.elapsed
        outcome = GoalOutcome(goal.pose, goal.time, goal.end, goal.reason, goal.source, goal.ended, time)
        if path is not None and (part := (path["t"] >= goal.time) & (path["t"] <= until)).any():
            outcome = _with_figures(outcome, {name: path[name][part] for name in ("x", "y", "theta")})
            outcome = outcome._replace(is_true="truth" in curves)
        found.append(outcome)
    return found


def _with_figures(outcome: GoalOutcome, path: Columns) -> GoalOutcome:
    """Fill in the figures of a drive along a path of poses x, y, theta."""
    x, y, theta = path["x"], path["y"], path["theta"]
    last = into_frame(Pose(float(x[-1]), float(y[-1]), float(theta[-1])), outcome.goal)
    turns = np.abs(np.diff(np.unwrap(theta[np.isfinite(theta)])))
    return outcome._replace(
        position_error=math.hypot(last.x, last.y),
        heading_error=abs(last.theta),
        path_length=float(np.hypot(np.diff(x), np.diff(y)).sum()),
        direct_distance=math.hypot(float(x[0]) - outcome.goal.x, float(y[0]) - outcome.goal.y),
        revolutions=float(turns.sum()) / (2.0 * math.pi),
    )


def is_reached(outcome: GoalOutcome, config: SwitchingConfig) -> bool:
    """Return True if a goal was answered as reached, and the pose at the answer is within the tolerances."""
    tolerance = config.tolerance
    return outcome.end == REACHED and not (
        outcome.position_error > tolerance.xy_goal_tolerance or outcome.heading_error > tolerance.yaw_goal_tolerance
    )


def cards_of(
    outcomes: Sequence[GoalOutcome],
    curves: Mapping[str, Columns],
    config: SwitchingConfig,
    wheels: WheelGeometry | None = None,
) -> list[dict[str, Any]]:
    """Return a card per goal for the page: level, verdict and lines in words, and the figures of the table.

    The card of a missed goal contains the causes that the curves show, see causes.py.
    """
    cards = []
    for index, one in enumerate(outcomes):
        following = outcomes[index + 1].accepted if index + 1 < len(outcomes) else math.inf
        last = max((float(columns["t"][-1]) for columns in curves.values() if len(columns["t"])), default=0.0)
        until = min(following, last) if math.isnan(one.ended) else one.ended
        level, verdict = _verdict(one, math.isinf(following), config)
        lines = list(_figure_lines(one, level)) if math.isfinite(one.position_error) else []
        if "law" in curves and "command" in curves:
            lines += _limits(curves["command"], one.accepted, until, config)
        if level > OK:
            lines = [*causes(curves, one.accepted, until, config, wheels), *lines]
        figures = ("time", "position_error", "heading_error", "path_length", "direct_distance", "revolutions")
        values = {name: getattr(one, name) for name in (*figures, "ended")}
        cards.append(
            {
                "goal": list(one.goal),
                "accepted": one.accepted,
                "end": one.end,
                "level": level,
                "verdict": verdict,
                "lines": lines,
                **{name: value if math.isfinite(value) else None for name, value in values.items()},
            }
        )
    return cards


def _verdict(one: GoalOutcome, is_last: bool, config: SwitchingConfig) -> Words:
    after = f"{max(one.time, 0.0):.1f} s"
    if one.end == REACHED:
        is_off = not is_reached(one, config)
        return (ERROR, f"Reported reached in {after}, but off the goal") if is_off else (OK, f"Reached in {after}")
    sender = f" (sent by {one.source})" if one.source else ""
    if one.end in (CANCELLED, REPLACED, PASSED):
        # The reason of a replaced goal names the sender of the newer goal.
        who = f": {one.reason}" if one.reason else sender
        return NEUTRAL, f"{one.end.capitalize()}{who} after {after}"
    if one.end:
        reason = one.reason.removeprefix("not reached ") if one.end == "not reached" else one.reason
        joint = " " if reason != one.reason else ": "
        words = one.end.capitalize() + (f"{joint}{reason}" if reason else "")
        return ERROR, f"{words} (after {after})"
    return WARNING, "No answer: the recording ends before" if is_last else "No answer in the recording"


def _figure_lines(one: GoalOutcome, level: int) -> list[Words]:
    whose, at = "True" if one.is_true else "Estimated", " at the answer" if one.end else ""
    error = f"{whose} error{at} {length_text(one.position_error)}, {degrees(one.heading_error):.1f} deg"
    path = f"Path {one.path_length:.2f} m, straight line {one.direct_distance:.2f} m"
    return [(ERROR if one.end == REACHED and level == ERROR else OK, error), (OK, path)]


def _limits(command: Columns, begin: float, end: float, config: SwitchingConfig) -> list[Words]:
    """Return a line that says whether the commands of an interval kept the limits; no line without limits."""
    part = (command["t"] >= begin) & (command["t"] <= end)
    sheet, found, is_kept = config.data_sheet, [], True
    # Without a pose, the controller stops the robot at once, so a step to zero is never beyond a limit.
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
            # A late recorder shortens a gap, but not the step in it.
            times, steps = np.maximum(gaps[joined], period), steps[joined]
            within = bool((steps <= rate_limit * (times + _SLACK * period)).all())
            is_kept = is_kept and within
            fastest = float((steps / times).max())
            found.append(f"{min(fastest, rate_limit) if within else fastest:.2f} of {rate_limit:.2f} {unit}^2")
    if not found:
        return []
    return [(OK, "Limits kept")] if is_kept else [(ERROR, f"BEYOND LIMITS: {', '.join(found)}")]


def result_line(cards: Sequence[Mapping[str, Any]]) -> Words:
    """Return the title of a report: how many goals were reached. A path counts as one goal, its last pose."""
    total = [one for one in cards if one["end"] != PASSED]
    if not total:
        return OK, "no goal in the recording"
    reached = sum(one["level"] == OK for one in total)
    is_failed = any(one["level"] == ERROR for one in total)
    return ERROR if is_failed else OK, f"{reached} of {len(total)} {'goal' if len(total) == 1 else 'goals'} reached"


def health_lines(
    curves: Mapping[str, Columns], events: Sequence[Event], lost: int | None, is_cut_off: bool
) -> list[Words]:
    """Return lines about the filter, the completeness of the recording and the faults, each with its level.

    Args:
        curves: of the robot.
        events: of the robot.
        lost: messages that the recorder lost; None: unknown.
        is_cut_off: the bag was not closed.
    """
    lines = [line for line in (_trust(curves),) if line]
    if is_cut_off:
        lines.append((WARNING, "recording cut off: the bag was not closed"))
    if lost is not None:
        lines.append((WARNING, f"{lost} messages lost") if lost else (OK, "no message lost"))
    # A state and its diagnosis have the same words, but other punctuation.
    found = {"".join(filter(str.isalnum, one.text)): one for one in reversed(_run_of(events)) if _is_fault(one)}
    faults = sorted(found.values(), key=lambda one: (-one.level, one.time))
    words = [one.text for one in faults]
    more = f" and {len(words) - _MAX_FAULTS} more" if len(words) > _MAX_FAULTS else ""
    text = f"faults: {'; '.join(words[:_MAX_FAULTS])}{more}" if words else "no fault reported"
    return [*lines, (faults[0].level if faults else OK, text)]


def _run_of(events: Sequence[Event]) -> list[Event]:
    """Return the events without the warnings of starting nodes and without the events of ending nodes.

    Nodes start until _START after the first goal. They end after the controller has become inactive for the last time.
    """
    last = max(
        (at for at, one in enumerate(events) if one.kind == "state" and one.text.startswith("controller: ")), default=0
    )
    run = events[:last] if last and events[last].text == "controller: inactive" else events
    started = next((one.time for one in run if one.kind == "goal"), -math.inf) + _START
    return [one for one in run if one.level >= ERROR or one.time > started]


def _is_fault(event: Event) -> bool:
    """Return True for faults, relocations and states that are errors; the card of a goal tells how it ended."""
    is_state = event.kind == "state" and event.level >= ERROR
    return (is_state or event.kind in ("fault", "relocation")) and f": {NOT_AT_GOAL}" not in event.text


def _trust(curves: Mapping[str, Columns]) -> Words | None:
    nees = curves["error"]["nees"] if "error" in curves else np.empty(0)
    nees, name, is_certain = nees[np.isfinite(nees)], "NEES", True
    bound = np.full(len(nees), NEES_BOUNDS[1])
    if not len(nees) and "filter" in curves:
        values, name, is_certain = curves["filter"], "NIS", False
        known = np.isfinite(values["nis"]) & np.isfinite(values["nis_high"])
        nees, bound = values["nis"][known], values["nis_high"][known]
    if not len(nees):
        return None
    share = float(np.mean(nees <= bound))
    figure = f"({name} below its 95 % bound {100.0 * share:.0f} % of the time)"
    if share >= TRUSTED_SHARE:
        return OK, f"filter: trustworthy {figure}"
    return ERROR if is_certain else WARNING, f"filter: overconfident {figure}"
