"""An open-loop drive with a constant command, followed by the filter, for the benchmark of the filter.

Plain numbers only: the form that compiles, and that runs as plain Python too; a test compares it with the world and the
filter of the nodes.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from diffbot_control.filter.gate import REJECTED, RELOCATED
from diffbot_core.geometry import Pose, wrap_angle
from diffbot_core.kinematics import Twist
from diffbot_core.uncertainty import largest_deviation
from diffbot_sim.compiled.ekf import pose_of
from diffbot_sim.compiled.gated_filter import Track, new_track, reported_belief, reset_arrays
from diffbot_sim.compiled.late_fusion import Buffers, Example, new_buffers
from diffbot_sim.compiled.sensing import Robot, observe
from diffbot_sim.model.actuators import command_rows, delayed_command
from diffbot_sim.model.philox import START_BLOCK, NoiseKey, direction, draw
from diffbot_sim.model.plant import new_plant, plant_step_at
from diffbot_sim.model.sensors import NO_ERRORS, due

AWAY = 0.5
"""[m] position error above which a filter counts as lost"""
V_MIDDLE, V_HALF, OMEGA_HALF = 0.7, 0.3, 0.3
"""[m/s], [m/s], [rad/s] of the drives: v is in 0.4 .. 1.0 m/s, omega in +-0.3 rad/s"""


class OpenLoopCase(NamedTuple):
    """What all runs of a case share."""

    robot: Robot
    steps: int
    skipped: int
    """steps at the start that do not count"""
    kidnapped: int
    """first step at which the robot stands at its new place; -1 for never"""
    example: Example
    """of the filter's arrays, see :func:`late_fusion.example_for`"""


class Tracking(NamedTuple):
    """How well the filter followed one run, over the steps that count."""

    position: float
    """[m] root of the mean squared position error"""
    heading: float
    """[rad] root of the mean squared heading error"""
    largest: float
    """[m] position error"""
    end: float
    """[m] position error"""
    back: float
    """[s] from the kidnapping until the position error is below AWAY for good; nan without one"""
    nis: float
    """mean of the fixes' normalised innovations squared, of rejected ones too; nan if none counts"""
    innovations: float
    """fixes in that mean: those that no heading or landmark followed in the same step"""
    nees: float
    """mean of the pose's normalised estimation error squared"""
    fixes: float
    rejected: float
    """fixes"""
    relocated: float
    """fixes after which the filter was relocated"""


class Sums(NamedTuple):
    """What is summed up along a run."""

    position: float
    heading: float
    largest: float
    last_away: int
    """last step with a position error above AWAY; -1 for none"""
    nis: float
    innovations: int
    nees: float
    fixes: int
    rejected: int
    relocated: int


class Errors(NamedTuple):
    """Estimate minus truth."""

    x: float
    y: float
    theta: float


def twist_of(seed: int, run: int) -> Twist:
    """Return the constant twist of a run."""
    noise = draw(seed, run, 0, START_BLOCK)
    return Twist(V_MIDDLE + V_HALF * noise.a, OMEGA_HALF * noise.b)


def start_of(seed: int, run: int) -> Pose:
    """Return the start of a run: the origin with a random heading."""
    return Pose(0.0, 0.0, direction(draw(seed, run, 0, START_BLOCK).c))


def drive(case: OpenLoopCase, seed: int, run: int, history: Any) -> Tracking:
    """Do one run.

    Args:
        case: what all runs share.
        seed: of all noise.
        run: number of the run.
        history: (steps + 1, 4) array whose rows are filled with the errors of position and heading and the deviations
            that the filter gives for them, or (0, 4) for none.
    """
    return _followed(new_buffers(0, len(case.robot.landmarks), case.example), case, seed, run, history)


def _followed(buffers: Buffers, case: OpenLoopCase, seed: int, run: int, history: Any) -> Tracking:
    command, plant = twist_of(seed, run), case.robot.plant
    t_s, delay = plant.sampling_time, plant.actuators.command_delay
    commands = np.zeros((command_rows(delay, t_s), 2))
    state = new_plant(start_of(seed, run))
    track, arrays, newest_errors = new_track(), buffers.filter[0], NO_ERRORS
    reset_arrays(arrays, case.robot.filter)
    sums = Sums(0.0, 0.0, 0.0, -1, 0.0, 0, 0.0, 0, 0, 0)
    end = 0.0
    for step in range(case.steps + 1):
        key = NoiseKey(seed, run, step)
        track, newest_errors = observe(track, arrays, buffers.seen[0], newest_errors, key, state, case.robot)
        reported = reported_belief(arrays, case.robot.filter)
        errors, P = errors_of(pose_of(reported), state.pose), reported["P"]
        end = math.hypot(errors.x, errors.y)
        if len(history) > 0:
            _record(history, step, errors, P)
        if step > case.skipped:
            sums = _summed(sums, case.robot, step, track, errors, P)
        if step < case.steps:
            state = plant_step_at(key, state, delayed_command(commands, step, command, delay, t_s), plant)
    return _tracking(case, sums, end)


def errors_of(pose: Pose, truth: Pose) -> Errors:
    """Return the errors of an estimated pose."""
    return Errors(pose.x - truth.x, pose.y - truth.y, wrap_angle(pose.theta - truth.theta))


def nees_of(errors: Errors, P: Any) -> float:
    """Return e' P^-1 e of the pose, by P = L L'; ``P`` is (n, n) with n >= 3."""
    xx = math.sqrt(P[0, 0])
    xy, xt = P[0, 1] / xx, P[0, 2] / xx
    yy = math.sqrt(P[1, 1] - xy * xy)
    yt = (P[1, 2] - xy * xt) / yy
    tt = math.sqrt(P[2, 2] - xt * xt - yt * yt)
    a = errors.x / xx
    b = (errors.y - xy * a) / yy
    c = (errors.theta - xt * a - yt * b) / tt
    return float(a * a + b * b + c * c)


def _record(history: Any, step: int, errors: Errors, P: Any) -> None:
    row = history[step]
    row[0], row[1] = math.hypot(errors.x, errors.y), errors.theta
    row[2], row[3] = largest_deviation(P[0, 0], P[0, 1], P[1, 1]), math.sqrt(P[2, 2])


def _summed(sums: Sums, robot: Robot, step: int, track: Track, errors: Errors, P: Any) -> Sums:
    """Add one step."""
    sensors, t_s = robot.sensors, robot.plant.sampling_time
    fixed = due(step, sensors.fix_rate, t_s)
    # The filter keeps only the innovation of the newest measurement, and headings and landmarks come after the fix.
    alone = fixed and not due(step, sensors.heading_rate, t_s) and not due(step, sensors.landmark_rate, t_s)
    away = math.hypot(errors.x, errors.y)
    return Sums(
        sums.position + away * away,
        sums.heading + errors.theta * errors.theta,
        max(sums.largest, away),
        sums.last_away if away <= AWAY else step,  # nan is away
        sums.nis + (track.newest.nis if alone else 0.0),
        sums.innovations + (1 if alone else 0),
        sums.nees + nees_of(errors, P),
        sums.fixes + (1 if fixed else 0),
        sums.rejected + (1 if fixed and track.newest.fix_outcome == REJECTED else 0),
        sums.relocated + (1 if fixed and track.newest.fix_outcome == RELOCATED else 0),
    )


def _tracking(case: OpenLoopCase, sums: Sums, end: float) -> Tracking:
    counted = case.steps - case.skipped
    back = math.nan
    if case.kidnapped >= 0:
        back = max(sums.last_away + 1 - case.kidnapped, 0) * case.robot.plant.sampling_time
    return Tracking(
        math.sqrt(sums.position / counted),
        math.sqrt(sums.heading / counted),
        sums.largest,
        end,
        back,
        sums.nis / sums.innovations if sums.innovations > 0 else math.nan,
        float(sums.innovations),
        sums.nees / counted,
        float(sums.fixes),
        float(sums.rejected),
        float(sums.relocated),
    )
