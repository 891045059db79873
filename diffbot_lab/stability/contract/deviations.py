"""What a contract bounds, in the histories of simulated runs: errors of the estimate, and of the base's motion."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from diffbot_control.law.braking_step import coasted_estimate
from diffbot_control.law.configuration import ControllerConfig, new_memory
from diffbot_control.law.controller import step
from diffbot_control.law.finish import fastest_leg, is_leg
from diffbot_control.law.goal_checker import knowable_heading
from diffbot_control.law.regions import OMEGA_G
from diffbot_core.errors import DiffbotError
from diffbot_core.geometry import Pose, wrap_angle
from diffbot_core.kinematics import Twist
from diffbot_core.uncertainty import Estimate, Uncertainty
from diffbot_lab.stability.compiled import compile_bounds
from diffbot_sim.model.plant import integrate

Array = NDArray[np.float64]

BOUNDED = ("eps_position", "eps_theta", "sigma_max", "eps_v", "eps_omega")
"""Fields of the contract that are the columns of deviations, in this order ..."""
ON_LEG, DISTANCE = len(BOUNDED), len(BOUNDED) + 1
"""... then 1 on a leg of the finish, else 0, and the distance [m] of the true pose, coasted, from the goal"""
_SAME = 1e-9
"""[m/s] and [rad/s] by which a command of the history may differ from the law's: rounding"""


def deviations(
    config: ControllerConfig, law: ControllerConfig, wheel_error: float, t_s: float, history: Any, out: Any
) -> bool:
    """Fill ``out`` (steps, 7) from one history (steps + 1, 10) of a run to the origin.

    The law is run again on what it was given. Where the pose is not known, or in Omega_L the heading not as well as the
    goal asks for, the deviations are infinite.

    Args:
        config: of the controller.
        law: the same as it requests.
        wheel_error: of the contract.
        t_s: [s]
        history: see ``HISTORY_COLUMNS``.
        out: rows of BOUNDED, ON_LEG and DISTANCE.

    Returns:
        False if the law's commands are not those of the history.
    """
    goal, memory, half = Pose(0.0, 0.0, 0.0), new_memory(), 0.5 * config.data_sheet.wheels.wheel_separation
    before, requested, known, is_far = goal, Twist(0.0, 0.0), False, False
    for index in range(len(history)):
        row, dt = history[index], t_s if index > 0 else 0.0
        if math.isnan(row[3]):
            known = False
            if index < len(out):
                out[index, :ON_LEG] = math.inf
            continue
        estimate = Estimate(Pose(row[3], row[4], row[5]), Uncertainty(row[8], row[9]))
        truth = Estimate(Pose(row[0], row[1], row[2]), estimate.uncertainty)
        _, seen = coasted_estimate(memory, estimate, dt, config)
        _, true = coasted_estimate(memory, truth, dt, config)
        if known:
            beside, turned = motion_errors(before, true.pose, requested, (wheel_error, half, t_s))
            if not is_far:
                faster, turned_more = excess_near(before, true.pose, law, t_s)
                beside, turned = min(beside, faster), min(turned, turned_more)
            out[index - 1, 3], out[index - 1, 4] = beside, turned
        if index == len(out):
            break
        _, requested, _ = step(memory, seen, goal, dt, law)
        memory, command, _ = step(memory, estimate, goal, dt, config)
        known, is_far, before = True, memory.switching.region == OMEGA_G, true.pose
        out[index, 0], out[index, 1], out[index, 2] = estimate_errors(seen, true.pose)
        if not is_far and not knowable_heading(config.tolerance, seen.uncertainty):
            out[index, 2] = math.inf
        out[index, ON_LEG] = 1.0 if is_leg(memory.finish) else 0.0
        out[index, DISTANCE] = math.hypot(true.pose.x, true.pose.y)
        if not abs(command.v - row[6]) + abs(command.omega - row[7]) < _SAME:
            return False
    return True


def estimate_errors(seen: Estimate, true: Pose) -> tuple[float, float, float]:
    """Return the errors of position [m] and heading [rad] of an estimate, and the deviation [m] that it reports."""
    distance = math.hypot(seen.pose.x - true.x, seen.pose.y - true.y)
    return distance, abs(wrap_angle(seen.pose.theta - true.theta)), seen.uncertainty.xy


def excess_near(before: Pose, after: Pose, law: ControllerConfig, t_s: float) -> tuple[float, float]:
    """Return by how much a motion in one step is faster [m/s] and turns faster [rad/s] than any of Omega_L may."""
    speed = math.hypot(after.x - before.x, after.y - before.y) / t_s
    rotation = abs(wrap_angle(after.theta - before.theta)) / t_s
    return max(speed - fastest_leg(law.finish), 0.0), max(rotation - law.data_sheet.omega_max, 0.0)


def motion_errors(
    before: Pose, after: Pose, requested: Twist, numbers: tuple[float, float, float]
) -> tuple[float, float]:
    """Return how far a motion in one step is from the requested one, [m/s] and [rad/s], beyond the wheels' errors.

    Args:
        before: pose.
        after: pose, a step later.
        requested: twist.
        numbers: errors of the wheels, half the distance of the wheels [m], and the time of the step [s].
    """
    wheel_error, half, t_s = numbers
    omega = wrap_angle(after.theta - before.theta) / t_s
    expected = integrate(before, Twist(requested.v, omega), t_s, True)
    allowed = wheel_error * max(abs(requested.v), half * abs(requested.omega))
    beside = max(math.hypot(after.x - expected.x, after.y - expected.y) / t_s - allowed, 0.0)
    return beside, max(abs(omega - requested.omega) - allowed / half, 0.0)


def _all(config: Any, law: Any, wheel_error: float, t_s: float, histories: Any, out: Any) -> int:
    """Return how many runs have the law's commands."""
    same = 0
    for run in range(len(histories)):
        same += deviations(config, law, wheel_error, t_s, histories[run], out[run])
    return same


_all_kernel = compile_bounds(_all)


def deviations_of(
    config: ControllerConfig, law: ControllerConfig, wheel_error: float, t_s: float, histories: Array
) -> Array:
    """Return the deviations (runs, steps, 7) of histories (runs, steps + 1, 10); see :func:`deviations`.

    Raises:
        DiffbotError: for histories of another law or configuration.
    """
    out = np.zeros((histories.shape[0], histories.shape[1] - 1, DISTANCE + 1))
    if _all_kernel(config, law, wheel_error, t_s, histories, out) < len(histories):
        raise DiffbotError("the histories are not those of this law: a step gives another command")
    return out
