"""Measure the contract of a robot in simulation: deviations, their bounds, and the share of runs within the bounds."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.stats import binomtest

from diffbot_control.law.configuration import SwitchingConfig
from diffbot_control.law.law import CONTACT_UNKNOWN, Observation
from diffbot_control.law.regions import leaving_radius
from diffbot_control.law.steering import approach_speed
from diffbot_control.law.switching import SwitchingLaw, coasted_estimate, new_memory, step
from diffbot_core.errors import DiffbotError, InvalidValueError
from diffbot_core.geometry import Pose, wrap_angle
from diffbot_core.kinematics import Twist
from diffbot_core.uncertainty import Estimate, Uncertainty
from diffbot_lab.cases import Configuration, make_case
from diffbot_lab.stability.compiled import compile_bounds
from diffbot_lab.stability.plan import SLOPES, Contract, IdealLaw, Plan, ideal_law, requested_command
from diffbot_lab.stability.runs import uniform_starts
from diffbot_sim.batch import Starts, run_histories
from diffbot_sim.plant import integrate
from diffbot_sim.robot_step import Case
from diffbot_tools.robot import RobotConfig

Array = NDArray[np.float64]

BOUNDED = ("eps_position", "eps_theta", "sigma_max", "eps_v", "eps_omega")
"""names of the first columns of an array of deviations, which are fields of the contract"""
DISTANCE = len(BOUNDED)
"""index of the last column: distance [m] of the coasted true pose from the goal"""
_SAME = 1e-9
"""[m/s], [rad/s] largest difference (a rounding error) between a recorded command and the law's command"""
_DURATION = 60.0
"""[s] duration of a run"""
_MAX_START = 12.0
"""[m] largest distance of a start from the goal; also [s] the largest time to the goal at full speed"""
_CHUNK = 100
"""number of runs whose histories are in memory at a time"""
_MIN_BOUND = 1e-3
"""[m], [rad], [m/s], [rad/s] smallest fitted bound"""


class RobotRuns(NamedTuple):
    """Runs of a robot's own simulation to one goal."""

    case: Case
    starts: Array
    """(runs, 3) poses"""


class KeptShare(NamedTuple):
    """Share of the runs that keep a contract in every step, with its 95 % confidence interval (Wilson)."""

    runs: float
    low: float
    high: float


class BaseStep(NamedTuple):
    """Period, and bound of the wheel errors."""

    wheel_error: float
    """[-] bound of the relative error of each wheel's speed"""
    t_s: float
    """[s]"""


def start_radius(robot: RobotConfig) -> float:
    """Return the distance [m] within which runs of a robot start: 12 s at full speed, at most 12 m."""
    return float(_MAX_START * min(1.0, robot.controller.supervisor.controller.data_sheet.v_max))


def runs_of_robot(robot: RobotConfig, count: int, seed: int) -> RobotRuns:
    """Return runs of a robot's own simulation to one goal.

    Raises:
        InvalidValueError: for a robot with another law or with a landmark sensor.
    """
    world, localization, supervisor, law = robot.parts(seed)
    if law is not SwitchingLaw:
        raise InvalidValueError("law", law.name, f"{SwitchingLaw.name}, for a certificate")
    if world.sensors.landmark_rate > 0.0:
        raise InvalidValueError("landmark_rate", world.sensors.landmark_rate, "0, for a contract")
    configuration = Configuration(world.plant, world.sensors, supervisor.controller, localization.filter)
    starts = uniform_starts(np.random.default_rng(seed), count, start_radius(robot))
    return RobotRuns(make_case(configuration, _DURATION)._replace(history_length=localization.history_length), starts)


def measure_deviations(runs: RobotRuns, contract: Contract, seed: int, bar: Any = None) -> Array:
    """Simulate runs and return their deviations (runs, steps, 6) from the requested motion.

    Args:
        runs: runs to simulate.
        contract: its ``wheel_error`` is subtracted from the deviations. The other bounds are not used.
        seed: seed of the noise.
        bar: progress bar, updated with the number of finished runs.
    """
    case, t_s = runs.case, runs.case.robot.plant.sampling_time
    # A base with limits requires bounds above 0. Their values do not matter here, because the deviations are measured.
    law = ideal_law(case.controller, Plan(contract._replace(eps_v=0.9, eps_omega=0.9), t_s))
    chunks = []
    for first in range(0, len(runs.starts), _CHUNK):
        count = min(_CHUNK, len(runs.starts) - first)
        histories = run_histories(case, Starts(runs.starts), seed, first, count)
        chunks.append(deviations_of(case.controller, law, contract.wheel_error, t_s, histories))
        if bar is not None:
            bar.update(count)
    return np.concatenate(chunks)


def is_kept(deviations: Array, contract: Contract) -> NDArray[np.bool_]:
    """Return (runs, steps), True where all deviations (runs, steps, 6) are within the bounds of a contract."""
    bounds = np.array([getattr(contract, name) for name in BOUNDED])
    return np.asarray((_without_slopes(deviations, contract) <= bounds).all(axis=-1))


def fit_bounds(deviations: Array, contract: Contract) -> dict[str, float]:
    """Return the smallest bounds for which all deviations (runs, steps, 6) keep a contract, rounded up to two digits.

    The slopes are not fitted; they are the slopes of ``contract``.
    """
    bounds = {}
    for name, largest in zip(BOUNDED, _without_slopes(deviations, contract).max(axis=(0, 1)), strict=True):
        value = max(float(largest), _MIN_BOUND)
        if value < math.inf:
            digit = 10.0 ** (math.floor(math.log10(value)) - 1)
            value = round(math.ceil(value / digit) * digit, 9)
        bounds[name] = value
    return bounds


def _without_slopes(deviations: Array, contract: Contract) -> Array:
    """Return the columns BOUNDED, minus the growth that the slopes of the contract allow at this distance."""
    rest = deviations[..., : len(BOUNDED)].copy()
    for column, name in enumerate(SLOPES):
        rest[..., column] -= getattr(contract, name) * deviations[..., DISTANCE]
    return rest


def kept_share(kept: NDArray[np.bool_]) -> KeptShare:
    """Return the share of the runs that keep a contract in every step, for a result (runs, steps) of is_kept."""
    runs = int(kept.all(axis=1).sum())
    interval = binomtest(runs, len(kept)).proportion_ci(method="wilson")
    return KeptShare(runs / len(kept), float(interval.low), float(interval.high))


def fill_deviations(
    config: SwitchingConfig, law: IdealLaw, wheel_error: float, t_s: float, history: Any, out: Any
) -> bool:
    """Fill ``out`` (steps, 6) with the deviations of one history (steps + 1, 12) of a run to the origin.

    The function runs the law again on the recorded estimates. Deviations are infinite while the pose is not known.

    Args:
        config: configuration of the controller.
        law: ideal law of this configuration.
        wheel_error: ``wheel_error`` of the contract.
        t_s: [s] period.
        history: array with the columns HISTORY_COLUMNS.
        out: array with the columns BOUNDED and DISTANCE.

    Returns:
        False if a command of the law differs from the recorded command.
    """
    goal, memory, base = Pose(0.0, 0.0, 0.0), new_memory(), BaseStep(wheel_error, t_s)
    before, requested, known, near = goal, Twist(0.0, 0.0), False, -1.0
    for index in range(len(history)):
        row, dt = history[index], t_s if index > 0 else 0.0
        if math.isnan(row[3]):
            known = False
            if index < len(out):
                out[index, :DISTANCE] = math.inf
            continue
        estimate = Estimate(Pose(row[3], row[4], row[5]), Uncertainty(row[8], row[9]))
        truth = Estimate(Pose(row[0], row[1], row[2]), estimate.uncertainty)
        _, measured = coasted_estimate(memory, estimate, dt, config)
        _, true = coasted_estimate(memory, truth, dt, config)
        if known:
            eps_v, eps_omega = motion_errors(before, true.pose, requested, law, base)
            if near >= 0.0:
                eps_v = min(eps_v, excess_speed_near_goal(before, true.pose, near, law, base))
                eps_omega = 0.0
            out[index - 1, 3], out[index - 1, 4] = eps_v, eps_omega
        observation = Observation(estimate, dt, t_s, CONTACT_UNKNOWN)
        memory, command, report = step(memory, observation, goal, config)
        if not abs(command.v - row[6]) + abs(command.omega - row[7]) < _SAME:
            return False
        if index == len(out):
            break
        known, before, requested = True, true.pose, requested_command(law, memory, measured)
        leaving = leaving_radius(measured.uncertainty.xy, config.tolerance)
        near = leaving if report.rho <= leaving else -1.0
        out[index, 0] = math.hypot(measured.pose.x - true.pose.x, measured.pose.y - true.pose.y)
        out[index, 1] = abs(wrap_angle(measured.pose.theta - true.pose.theta))
        out[index, 2] = measured.uncertainty.xy
        out[index, DISTANCE] = math.hypot(true.pose.x, true.pose.y)
    return True


def excess_speed_near_goal(before: Pose, after: Pose, leaving: float, law: IdealLaw, base: BaseStep) -> float:
    """Return by how much [m/s] a step near the goal is faster than the law's largest request plus the wheel errors.

    Args:
        before: pose before the step.
        after: pose after the step.
        leaving: [m] leaving radius of Omega_L.
        law: ideal law.
        base: period and wheel errors.
    """
    sheet = law.config.data_sheet
    speed = approach_speed(leaving, 1.0, law.gains, sheet.v_max)
    allowed = speed + wheel_allowance(Twist(speed, sheet.omega_max), law, base)
    return max(math.hypot(after.x - before.x, after.y - before.y) / base.t_s - allowed, 0.0)


def motion_errors(before: Pose, after: Pose, requested: Twist, law: IdealLaw, base: BaseStep) -> tuple[float, float]:
    """Return the errors [m/s] and [rad/s] of a step, after subtracting the largest effect of the wheel errors.

    The first error is the distance from the end of the requested motion, divided by the period. The second error is the
    difference from the requested turn rate.

    Args:
        before: pose before the step.
        after: pose after the step.
        requested: requested command.
        law: ideal law.
        base: period and wheel errors.
    """
    t_s, allowed = base.t_s, wheel_allowance(requested, law, base)
    omega = wrap_angle(after.theta - before.theta) / t_s
    expected = integrate(before, Twist(requested.v, omega), t_s, True)
    eps_v = max(math.hypot(after.x - expected.x, after.y - expected.y) / t_s - allowed, 0.0)
    half = 0.5 * law.config.data_sheet.wheels.wheel_separation
    return eps_v, max(abs(omega - requested.omega) - allowed / half, 0.0)


def wheel_allowance(requested: Twist, law: IdealLaw, base: BaseStep) -> float:
    """Return the largest error [m/s] of the speed that the errors of the wheels can cause."""
    half = 0.5 * law.config.data_sheet.wheels.wheel_separation
    return base.wheel_error * max(abs(requested.v), half * abs(requested.omega))


def _fill_all(config: Any, law: Any, wheel_error: float, t_s: float, histories: Any, out: Any) -> int:
    """Fill the deviations of all runs. Return the number of runs whose commands equal the commands of the law."""
    same = 0
    for run in range(len(histories)):
        same += fill_deviations(config, law, wheel_error, t_s, histories[run], out[run])
    return same


_fill_kernel = compile_bounds(_fill_all)


def deviations_of(config: SwitchingConfig, law: IdealLaw, wheel_error: float, t_s: float, histories: Array) -> Array:
    """Return the deviations (runs, steps, 6) of histories (runs, steps + 1, 12); see :func:`fill_deviations`.

    Raises:
        DiffbotError: if the histories were recorded with another law or configuration.
    """
    out = np.zeros((histories.shape[0], histories.shape[1] - 1, DISTANCE + 1))
    if _fill_kernel(config, law, wheel_error, t_s, histories, out) < len(histories):
        raise DiffbotError("the histories were recorded with another law or configuration: the commands differ")
    return out
