"""Measures the contract of a robot in its own simulation: deviations, bounds that hold, and how often they hold."""

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
from diffbot_lab.stability.plan import SLOPES, Contract, Plan, Requests, request, requesting
from diffbot_lab.stability.runs import uniform_starts
from diffbot_sim.batch import Starts, run_histories
from diffbot_sim.plant import integrate
from diffbot_sim.robot_step import Case
from diffbot_tools.robot import RobotConfig

Array = NDArray[np.float64]

BOUNDED = ("eps_position", "eps_theta", "sigma_max", "eps_v", "eps_omega")
"""Fields of the contract that are the columns of deviations, in this order ..."""
DISTANCE = len(BOUNDED)
"""... then the distance [m] of the true pose, coasted, from the goal"""
_SAME = 1e-9
"""[m/s] and [rad/s] by which a command of the history may differ from the law's: rounding"""
_DURATION = 60.0
"""[s] of a robot's run"""
_FAR = 12.0
"""[m] and seconds at full speed: a robot starts within the smaller of these distances"""
_CHUNK = 100
"""runs whose histories are in memory at a time"""
_LEAST = 1e-3
"""[m], [rad], [m/s], [rad/s] smallest fitted bound"""


class RobotRuns(NamedTuple):
    """Runs of a robot's own simulation to one goal."""

    case: Case
    starts: Array
    """(runs, 3) poses"""


class KeptShare(NamedTuple):
    """Share of the runs that keep a contract in every step, with Wilson's interval of 95 %."""

    runs: float
    low: float
    high: float


def farthest_start(robot: RobotConfig) -> float:
    """Return the distance [m] within which runs of a robot start: 12 s at full speed, at most 12 m."""
    return float(_FAR * min(1.0, robot.controller.supervisor.controller.data_sheet.v_max))


def runs_of_robot(robot: RobotConfig, count: int, seed: int) -> RobotRuns:
    """Return runs of a robot's own simulation to one goal.

    Raises:
        InvalidValueError: for a robot with another law, or with a sensor of landmarks.
    """
    world, localization, supervisor, law = robot.parts(seed)
    if law is not SwitchingLaw:
        raise InvalidValueError("law", law.name, f"{SwitchingLaw.name}, for a certificate")
    if world.sensors.landmark_rate > 0.0:
        raise InvalidValueError("landmark_rate", world.sensors.landmark_rate, "0, for a contract")
    configuration = Configuration(world.plant, world.sensors, supervisor.controller, localization.filter)
    starts = uniform_starts(np.random.default_rng(seed), count, farthest_start(robot))
    return RobotRuns(make_case(configuration, _DURATION)._replace(history_length=localization.history_length), starts)


def observe(runs: RobotRuns, contract: Contract, seed: int, bar: Any = None) -> Array:
    """Simulate runs; return the deviations (runs, steps, 6) from the law as it requests.

    Args:
        runs: to simulate.
        contract: of which only the errors of the wheels matter.
        seed: of noise.
        bar: of progress, updated by runs.
    """
    case, t_s = runs.case, runs.case.robot.plant.sampling_time
    # The bounds of the base are not used: how far it is from the request is what is measured.
    law = requesting(case.controller, Plan(contract._replace(eps_v=0.9, eps_omega=0.9), t_s))
    found = []
    for first in range(0, len(runs.starts), _CHUNK):
        count = min(_CHUNK, len(runs.starts) - first)
        histories = run_histories(case, Starts(runs.starts), seed, first, count)
        found.append(deviations_of(case.controller, law, contract.wheel_error, t_s, histories))
        if bar is not None:
            bar.update(count)
    return np.concatenate(found)


def kept(deviations: Array, contract: Contract) -> NDArray[np.bool_]:
    """Return (runs, steps) where all deviations (runs, steps, 6) are within the bounds of a contract."""
    bounds = np.array([getattr(contract, name) for name in BOUNDED])
    return np.asarray((_beyond_slopes(deviations, contract) <= bounds).all(axis=-1))


def fitted(deviations: Array, contract: Contract, share: float) -> dict[str, float]:
    """Return bounds that a share of the runs keeps in all steps, each bound by itself; two digits, rounded up.

    Args:
        deviations: (runs, steps, 6).
        contract: whose slopes are kept.
        share: of the runs.
    """
    found = {}
    for name, worst in zip(BOUNDED, _beyond_slopes(deviations, contract).max(axis=1).T, strict=True):
        value = max(float(np.quantile(worst, share, method="inverted_cdf")), _LEAST)
        digit = 10.0 ** (math.floor(math.log10(value)) - 1) if value < math.inf else 1.0
        found[name] = round(math.ceil(value / digit) * digit, 9) if value < math.inf else math.inf
    return found


def _beyond_slopes(deviations: Array, contract: Contract) -> Array:
    """Return the columns BOUNDED less the allowance of the contract's slopes at the distance of each step."""
    beyond = deviations[..., : len(BOUNDED)].copy()
    for column, name in enumerate(SLOPES):
        beyond[..., column] -= getattr(contract, name) * deviations[..., DISTANCE]
    return beyond


def share_of(within: NDArray[np.bool_]) -> KeptShare:
    """Return the share of the runs (runs, steps) that keep a contract in every step."""
    whole = int(within.all(axis=1).sum())
    interval = binomtest(whole, len(within)).proportion_ci(method="wilson")
    return KeptShare(whole / len(within), float(interval.low), float(interval.high))


def deviations(config: SwitchingConfig, law: Requests, wheel_error: float, t_s: float, history: Any, out: Any) -> bool:
    """Fill ``out`` (steps, 6) from one history (steps + 1, 12) of a run to the origin.

    The law is run again on what it was given. Where the pose is not known, the deviations are infinite.

    Args:
        config: of the controller.
        law: the same as it requests.
        wheel_error: of the contract.
        t_s: [s]
        history: see ``HISTORY_COLUMNS``.
        out: rows of BOUNDED and DISTANCE.

    Returns:
        False if the law's commands are not those of the history.
    """
    goal, memory, numbers = Pose(0.0, 0.0, 0.0), new_memory(), Step(wheel_error, t_s)
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
        _, seen = coasted_estimate(memory, estimate, dt, config)
        _, true = coasted_estimate(memory, truth, dt, config)
        if known:
            beside, turned = motion_errors(before, true.pose, requested, law, numbers)
            if near >= 0.0:
                beside, turned = min(beside, excess_near(before, true.pose, near, law, numbers)), 0.0
            out[index - 1, 3], out[index - 1, 4] = beside, turned
        observation = Observation(estimate, dt, t_s, CONTACT_UNKNOWN)
        memory, command, report = step(memory, observation, goal, config)
        if not abs(command.v - row[6]) + abs(command.omega - row[7]) < _SAME:
            return False
        if index == len(out):
            break
        known, before, requested = True, true.pose, request(law, memory, seen)
        leaving = leaving_radius(seen.uncertainty.xy, config.tolerance)
        near = leaving if report.rho <= leaving else -1.0
        out[index, 0], out[index, 1], out[index, 2] = estimate_errors(seen, true.pose)
        out[index, DISTANCE] = math.hypot(true.pose.x, true.pose.y)
    return True


class Step(NamedTuple):
    """Numbers of one step of the base."""

    wheel_error: float
    """[-] bound of the relative error of each wheel's speed"""
    t_s: float
    """[s]"""


def estimate_errors(seen: Estimate, true: Pose) -> tuple[float, float, float]:
    """Return the errors of position [m] and heading [rad] of an estimate, and the deviation [m] that it reports."""
    distance = math.hypot(seen.pose.x - true.x, seen.pose.y - true.y)
    return distance, abs(wrap_angle(seen.pose.theta - true.theta)), seen.uncertainty.xy


def excess_near(before: Pose, after: Pose, leaving: float, law: Requests, numbers: Step) -> float:
    """Return by how much a motion in one step is faster [m/s] than the contract allows near the goal.

    Args:
        before: pose.
        after: pose, a step later.
        leaving: [m] largest measured distance that counts as near.
        law: as it requests.
        numbers: of the step.
    """
    sheet = law.config.data_sheet
    speed = approach_speed(leaving, 1.0, law.gains, sheet.v_max)
    allowed = speed + wheel_allowance(Twist(speed, sheet.omega_max), law, numbers)
    return max(math.hypot(after.x - before.x, after.y - before.y) / numbers.t_s - allowed, 0.0)


def motion_errors(before: Pose, after: Pose, requested: Twist, law: Requests, numbers: Step) -> tuple[float, float]:
    """Return how far a motion in one step is from the requested one, [m/s] and [rad/s], beyond the wheels' errors.

    Args:
        before: pose.
        after: pose, a step later.
        requested: twist.
        law: as it requests.
        numbers: of the step.
    """
    t_s, allowed = numbers.t_s, wheel_allowance(requested, law, numbers)
    omega = wrap_angle(after.theta - before.theta) / t_s
    expected = integrate(before, Twist(requested.v, omega), t_s, True)
    beside = max(math.hypot(after.x - expected.x, after.y - expected.y) / t_s - allowed, 0.0)
    half = 0.5 * law.config.data_sheet.wheels.wheel_separation
    return beside, max(abs(omega - requested.omega) - allowed / half, 0.0)


def wheel_allowance(requested: Twist, law: Requests, numbers: Step) -> float:
    """Return the largest error [m/s] of the speed that the errors of the wheels can cause."""
    half = 0.5 * law.config.data_sheet.wheels.wheel_separation
    return numbers.wheel_error * max(abs(requested.v), half * abs(requested.omega))


def _all(config: Any, law: Any, wheel_error: float, t_s: float, histories: Any, out: Any) -> int:
    """Return how many runs have the law's commands."""
    same = 0
    for run in range(len(histories)):
        same += deviations(config, law, wheel_error, t_s, histories[run], out[run])
    return same


_all_kernel = compile_bounds(_all)


def deviations_of(config: SwitchingConfig, law: Requests, wheel_error: float, t_s: float, histories: Array) -> Array:
    """Return the deviations (runs, steps, 6) of histories (runs, steps + 1, 12); see :func:`deviations`.

    Raises:
        DiffbotError: for histories of another law or configuration.
    """
    out = np.zeros((histories.shape[0], histories.shape[1] - 1, DISTANCE + 1))
    if _all_kernel(config, law, wheel_error, t_s, histories, out) < len(histories):
        raise DiffbotError("the histories are not those of this law: a step gives another command")
    return out
