"""Results of a bag: how each goal and each docking ended, and the health of filter, recording and nodes.

``diffbot demo`` and the report use the same definitions. The error of a goal is the error of the pose at the answer of
the controller. The time of a goal is the time from its acceptance to the answer. A docking is a goal in the frame of
the dock.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from math import degrees
from typing import Any, NamedTuple

import numpy as np

from diffbot_control.goals.record import CANCELLED, REACHED, REPLACED, end_text
from diffbot_control.goals.states import NOT_AT_GOAL
from diffbot_control.law.configuration import SwitchingConfig
from diffbot_core.geometry import Pose, into_frame
from diffbot_core.kinematics import WheelGeometry
from diffbot_tools.view.causes import causes
from diffbot_tools.view.columns import Columns
from diffbot_tools.view.constants import NEES_BOUNDS
from diffbot_tools.view.events import Event, docking_verb
from diffbot_tools.view.goal_list import PASSED, Goal
from diffbot_tools.view.texts import ERROR, OK, WARNING
from diffbot_tools.view.words import Words, length_text

NEUTRAL = -1
"""Level of a goal that was neither reached nor missed, but cancelled, replaced or passed."""
TRUSTED_SHARE = 0.9
"""A filter is trustworthy if it is below its 95 % bound for this share of the time. The share is less than 95 %, since
consecutive errors are correlated."""
_ROUNDING = 1e-6
_LIMITS = (("v", "m/s"), ("omega", "rad/s"))
_SLACK = 0.5
"""[periods] Largest difference between the time at which the controller computed a command and its recorded time."""
_MAX_FAULTS = 3
_START = 2.0
"""[s] Warnings are ignored until this time after the first goal, since nodes are still starting."""
_DOCKING_CURVES = ("docking", "odometry", "command", "truth")
"""Curves in which the causes of a failed docking are searched."""


class GoalOutcome(NamedTuple):
    """How a goal ended.

    The figures describe the drive from the acceptance of the goal to its answer. They are computed from the true poses
    if the bag has them, else from the estimated poses.
    """

    goal: Pose
    """[m, m, rad] in the map; of a docking, in the frame of the dock"""
    accepted: float
    """[s] when the controller accepted the goal, since the first pose of the bag"""
    end: str = ""
    """one of diffbot_control.goals.record.ENDS, or PASSED; empty if the bag has no answer"""
    reason: str = ""
    """reason of the end; may be empty"""
    source: str = ""
    """sender of the goal: a topic, an action or a request"""
    ended: float = math.nan
    """[s] when the goal was answered, since the first pose of the bag; nan without an answer"""
    time: float = math.nan
    """[s] from the acceptance to the answer, by the controller; nan without an answer"""
    position_error: float = math.nan
    """[m] distance from the goal at the answer; without an answer, at the end of the drive"""
    heading_error: float = math.nan
    """[rad] at the same time, not negative"""
    is_true: bool = False
    """True if the figures are computed from the true poses"""
    path_length: float = math.nan
    """[m] travelled, forwards and backwards"""
    direct_distance: float = math.nan
    """[m] from the pose at the acceptance to the goal"""
    revolutions: float = math.nan
    """turns in both directions; 1 is a full turn"""


def outcomes_of(goals: Sequence[Goal], curves: Mapping[str, Columns]) -> list[GoalOutcome]:
    """Return how each goal ended, without a goal that was reached before the recording.

    Args:
        goals: in the order of time.
        curves: with ``truth`` or ``estimate``, the path in the frame of the goals.
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
    """Return the outcome with the figures of a drive along a path of poses x, y, theta."""
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
    goals: Sequence[GoalOutcome],
    curves: Mapping[str, Columns],
    config: SwitchingConfig,
    wheels: WheelGeometry | None = None,
    dockings: Sequence[GoalOutcome] = (),
) -> list[dict[str, Any]]:
    """Return the cards of the page in the order of time: level, verdict and lines in words, and figures of the table.

    The card of a missed goal also contains the causes that causes.py finds in the curves.

    Args:
        goals: outcomes of the goals in the map.
        curves: of the robot.
        config: configuration of the controller in the map.
        wheels: None if unknown.
        dockings: outcomes of the goals in the frame of the dock.
    """
    last = max((float(columns["t"][-1]) for columns in curves.values() if len(columns["t"])), default=0.0)
    in_map = {name: columns for name, columns in curves.items() if name != "docking"}
    at_dock = {name: curves[name] for name in _DOCKING_CURVES if name in curves}
    cards = []
    for number, (one, following) in enumerate(_with_following(goals), 1):
        x, y, theta = one.goal
        title = f"Goal {number}: {x:.2f}, {y:.2f} m, {round(degrees(theta))} deg"
        until = min(following, last) if math.isnan(one.ended) else one.ended
        verdict = _verdict(one, math.isinf(following), is_reached(one, config))
        lines = _figure_lines(one, verdict[0])
        if "law" in curves and "command" in curves:
            lines += _limit_lines(curves["command"], one.accepted, until, config)
        if verdict[0] > OK:
            lines = [*causes(in_map, one.accepted, until, config, wheels), *lines]
        cards.append(_card(one, title, verdict, lines))
    for one, following in _with_following(dockings):
        title = docking_verb(one.goal).capitalize()
        until = min(following, last) if math.isnan(one.ended) else one.ended
        verdict = _verdict(one, math.isinf(following), True, f"{title}ed")
        lines = _figure_lines(one, verdict[0])
        if verdict[0] > OK:
            lines = [*causes(at_dock, one.accepted, until, config, wheels), *lines]
        cards.append(_card(one, title, verdict, lines, is_docking=True))
    return sorted(cards, key=lambda card: float(card["accepted"]))


def _with_following(outcomes: Sequence[GoalOutcome]) -> list[tuple[GoalOutcome, float]]:
    """Return each goal with the time [s] at which the next goal was accepted, which is infinite for the last goal."""
    times = [one.accepted for one in outcomes] + [math.inf]
    return list(zip(outcomes, times[1:], strict=True))


def _card(one: GoalOutcome, title: str, verdict: Words, lines: list[Words], is_docking: bool = False) -> dict[str, Any]:
    figures = ("time", "ended", "position_error", "heading_error", "path_length", "direct_distance", "revolutions")
    values = {name: getattr(one, name) for name in figures}
    return {
        "title": title,
        "accepted": one.accepted,
        "end": one.end,
        "level": verdict[0],
        "verdict": verdict[1],
        "lines": lines,
        "isDocking": is_docking,
        **{name: value if math.isfinite(value) else None for name, value in values.items()},
    }


def _verdict(one: GoalOutcome, is_last: bool, is_confirmed: bool, reached: str = "Reached") -> Words:
    """Return level and text of the result of a goal.

    Args:
        one: the goal.
        is_last: True if no other goal follows.
        is_confirmed: False if the pose contradicts the answer ``reached``.
        reached: word for a goal that was reached.
    """
    after = f"{max(one.time, 0.0):.1f} s"
    if one.end == REACHED and is_confirmed:
        return OK, f"{reached} in {after}"
    if one.end == REACHED:
        return ERROR, f"Reported reached in {after}, but off the goal"
    if one.end in (CANCELLED, REPLACED, PASSED):
        # The reason of a replaced goal names the sender of the newer goal.
        sender = f" (sent by {one.source})" if one.source else ""
        return NEUTRAL, f"{one.end.capitalize()}{f': {one.reason}' if one.reason else sender} after {after}"
    if one.end:
        # A reason may begin with the end, such as "not reached within 4 s".
        is_repeated = one.reason.startswith(f"{one.end} ")
        text = one.reason if is_repeated else end_text(one.end, one.reason)
        return ERROR, f"{text[0].upper()}{text[1:]} (after {after})"
    return WARNING, "No answer: the recording ends before" if is_last else "No answer in the recording"


def _figure_lines(one: GoalOutcome, level: int) -> list[Words]:
    if math.isnan(one.position_error):
        return []
    whose, at = "True" if one.is_true else "Estimated", " at the answer" if one.end else ""
    error = f"{whose} error{at} {length_text(one.position_error)}, {degrees(one.heading_error):.1f} deg"
    path = f"Path {one.path_length:.2f} m, straight line {one.direct_distance:.2f} m"
    return [(ERROR if one.end == REACHED and level == ERROR else OK, error), (OK, path)]


def _limit_lines(command: Columns, begin: float, end: float, config: SwitchingConfig) -> list[Words]:
    """Return a line about whether the commands between two times [s] kept the limits; no line without limits."""
    part = (command["t"] >= begin) & (command["t"] <= end)
    sheet, found, is_kept = config.data_sheet, [], True
    # Without a pose, the controller stops the robot at once. Therefore steps to zero are not compared with the limits.
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
            # If the recorder is late, recorded gaps can be shorter than the period of the controller.
            times, steps = np.maximum(gaps[joined], period), steps[joined]
            within = bool((steps <= rate_limit * (times + _SLACK * period)).all())
            is_kept = is_kept and within
            fastest = float((steps / times).max())
            found.append(f"{min(fastest, rate_limit) if within else fastest:.2f} of {rate_limit:.2f} {unit}^2")
    if not found:
        return []
    return [(OK, "Limits kept")] if is_kept else [(ERROR, f"Limits exceeded: {', '.join(found)}")]


def result_line(cards: Sequence[Mapping[str, Any]]) -> Words:
    """Return the title of a report: how many goals were reached, cancelled and replaced. A path counts as one goal."""
    parts = []
    for is_docking, noun, done in ((False, "goal", "reached"), (True, "docking drive", "done")):
        own = [one for one in cards if one["isDocking"] == is_docking and one["end"] != PASSED]
        count = sum(one["level"] == OK for one in own)
        if own:
            parts.append(f"{count} of {len(own)} {noun}{'' if len(own) == 1 else 's'} {done}")
        neutral = Counter(str(one["end"]) for one in own if one["level"] == NEUTRAL)
        parts += [f"{number} {end}" for end, number in neutral.items()]
    is_failed = any(one["level"] == ERROR for one in cards)
    return ERROR if is_failed else OK, ", ".join(parts) or "no goal in the recording"


def health_lines(
    curves: Mapping[str, Columns], events: Sequence[Event], lost: int | None, is_cut_off: bool
) -> list[Words]:
    """Return lines about the filter, the completeness of the recording and the faults, each with its level.

    Args:
        curves: of the robot.
        events: of the robot.
        lost: number of messages that the recorder lost; None if unknown.
        is_cut_off: the bag was not closed.
    """
    lines = [line for line in (_trust(curves),) if line]
    if is_cut_off:
        lines.append((WARNING, "recording cut off: the bag was not closed"))
    if lost is not None:
        lines.append((WARNING, f"{lost} messages lost") if lost else (OK, "no message lost"))
    # A state and its diagnosis differ only in punctuation.
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
    """Return True for faults, relocations and states that are errors, except for goals that were not reached."""
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
