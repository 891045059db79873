"""Outcome of a run, accumulated step by step, for the reference loop and the compiled loop."""

from __future__ import annotations

import math
from typing import NamedTuple

from diffbot_control.law.regions import OMEGA_G, OMEGA_L
from diffbot_core.geometry import Pose, into_frame, wrap_angle
from diffbot_core.kinematics import Twist

TURNING_RADIUS = 1.0
"""[m] distance from the goal within which turns are summed"""


class Outcome(NamedTuple):
    """Result of a run."""

    x: float
    """[m] true end pose in the goal's frame"""
    y: float
    """[m]"""
    theta: float
    """[rad]"""
    settling_time: float
    """[s] until the last entry into the tolerances; nan if the run ends outside"""
    path_length: float
    """[m]"""
    effort: float
    """integral of v^2 + omega^2 over time [m^2/s + rad^2/s]"""
    switches: float
    """number of changes of region"""
    local_time: float
    """[s] time of the first entry into Omega_L; nan if there is none"""
    estimation_error: float
    """[m] distance between the last pose that the controller received and the true pose; nan if it received none"""
    turning: float
    """[rad] sum of the absolute turns of the true pose within TURNING_RADIUS of the goal"""
    reached_time: float
    """[s] when the law first reported the goal as reached; nan if it did not"""
    false_reached: float
    """1 if the true pose was outside the tolerances at ``reached_time``, else 0"""


class Criteria(NamedTuple):
    """Goal, tolerances and length of a run."""

    goal: Pose
    """in map"""
    xy_tolerance: float
    """[m] for the settling time"""
    yaw_tolerance: float
    """[rad] for the settling time"""
    sampling_time: float
    """[s]"""
    steps: int
    """number of steps; the run has one more pose"""


class LawState(NamedTuple):
    """Report of the law at the start of a step."""

    region: int
    reached: bool
    """True if the law reports the goal as reached"""


class RunTotals(NamedTuple):
    """Totals of the steps of a run so far."""

    last_outside: int
    """last step outside the tolerances, -1 if there is none"""
    path_length: float
    """[m]"""
    effort: float
    """[m^2/s + rad^2/s]"""
    local_time: float
    """[s] nan until the robot enters Omega_L"""
    region: int
    """region in the last step"""
    switches: int
    """number of changes of region"""
    turning: float
    """[rad] within TURNING_RADIUS of the goal"""
    reached_time: float
    """[s] nan until the law reports the goal as reached"""
    false_reached: float
    """1 if the true pose was outside the tolerances at ``reached_time``, else 0"""


def new_totals() -> RunTotals:
    """Return the totals before the first step."""
    return RunTotals(-1, 0.0, 0.0, math.nan, OMEGA_G, 0, 0.0, math.nan, 0.0)


def add_step(
    totals: RunTotals, criteria: Criteria, step: int, law: LawState, command: Twist, before: Pose, after: Pose
) -> RunTotals:
    """Return the totals with one more step.

    Args:
        totals: totals of the previous steps.
        criteria: criteria of the run.
        step: number of the step, 0 .. ``criteria.steps``. The robot does not move in the last step.
        law: report of the law at the start of the step.
        command: twist [m/s, rad/s] that is held over the step.
        before: true pose at the start of the step, in map.
        after: true pose at the end of the step, in map.
    """
    t_s = criteria.sampling_time
    local = into_frame(before, criteria.goal)
    distance = math.hypot(local.x, local.y)
    inside = distance <= criteria.xy_tolerance and abs(local.theta) <= criteria.yaw_tolerance
    enters_local = law.region == OMEGA_L and math.isnan(totals.local_time)
    turn = abs(wrap_angle(after.theta - before.theta)) if distance <= TURNING_RADIUS else 0.0
    first_reached = law.reached and math.isnan(totals.reached_time)
    power = command.v * command.v + command.omega * command.omega if step < criteria.steps else 0.0
    return RunTotals(
        totals.last_outside if inside else step,  # nan is not inside
        totals.path_length + math.hypot(after.x - before.x, after.y - before.y),
        totals.effort + power * t_s,
        step * t_s if enters_local else totals.local_time,
        law.region,
        totals.switches + 1 if law.region != totals.region else totals.switches,
        totals.turning + turn,
        step * t_s if first_reached else totals.reached_time,
        1.0 if first_reached and not inside else totals.false_reached,
    )


def outcome_of(totals: RunTotals, criteria: Criteria, feedback: Pose, has_feedback: bool, pose: Pose) -> Outcome:
    """Return the outcome of a run.

    Args:
        totals: totals of all steps.
        criteria: criteria of the run.
        feedback: last pose that the controller received.
        has_feedback: False if the controller received no pose.
        pose: true pose at the end, in map.
    """
    local = into_frame(pose, criteria.goal)
    settling_time = math.nan
    if totals.last_outside < criteria.steps:
        settling_time = (totals.last_outside + 1) * criteria.sampling_time
    error = math.nan
    if has_feedback:
        error = math.hypot(feedback.x - pose.x, feedback.y - pose.y)
    return Outcome(
        local.x,
        local.y,
        local.theta,
        settling_time,
        totals.path_length,
        totals.effort,
        float(totals.switches),
        totals.local_time,
        error,
        totals.turning,
        totals.reached_time,
        totals.false_reached,
    )
