"""Nonlinear model predictive control with the true model, a law that only shows what a law could reach.

It predicts the unicycle from the coasted pose, which holds dead time and lag as for every law of the arena, under the
limits of the data sheet. The periods of the horizon grow, from the sampling time to 2 s, so that it reaches the goal
from anywhere in the arena. Cost: distance and heading error, integrated over time, both rounded off near zero:

    J = sum h (sqrt(x^2 + y^2 + eps_xy^2) + w sqrt(theta^2 + eps_yaw^2) + r (v^2 + omega^2))
"""

from __future__ import annotations

import functools
import math
from typing import Annotated, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from diffbot_control.law.configuration import Report
from diffbot_control.law.goal_checker import GoalTolerance
from diffbot_core.data_sheet import DataSheet
from diffbot_core.geometry import Pose, wrap_angle
from diffbot_core.kinematics import Twist
from diffbot_core.schema import Spec
from diffbot_core.uncertainty import Estimate
from diffbot_lab.arena.bounds.drive import GUESSES, guessed, sampled
from diffbot_lab.arena.bounds.model import QUIET, Row, load_casadi, moved, rim_rows, stacked
from diffbot_lab.laws.common import (
    DRIVING,
    REACHED,
    STOP,
    LawMemory,
    LawState,
    Situation,
    Stop,
    conclude,
    new_law_memory,
    situation_of,
)

Array = NDArray[np.float64]

_SLOW_V, _SLOW_OMEGA = 0.1, 0.3
"""[m/s], [rad/s] a faster robot does not stop yet"""
_IPOPT = {
    **QUIET,
    "ipopt.tol": 1e-3,
    "ipopt.max_iter": 60,
    "ipopt.mu_init": 1e-3,
    "ipopt.warm_start_init_point": "yes",
}


class NmpcConfig(NamedTuple):
    """Horizon and weights."""

    periods: Annotated[int, Spec("periods of the horizon", "-", 2, 200)] = 20
    period: Annotated[float, Spec("length of the first one, the sampling time", "s", 1e-3, 10.0)] = 0.1
    growth: Annotated[float, Spec("ratio of a period to the one before", "-", 1.0, 2.0)] = 1.18
    heading_weight: Annotated[float, Spec("w, weight of the heading error", "m/rad", 0.0, 100.0)] = 0.3
    effort_weight: Annotated[float, Spec("r, weight of v^2 + omega^2", "-", 0.0, 100.0)] = 1e-3
    eps_xy: Annotated[float, Spec("rounding of the distance", "m", 1e-4, 10.0)] = 0.02
    eps_yaw: Annotated[float, Spec("rounding of the heading error", "rad", 1e-4, 10.0)] = 0.05
    stop: Stop = Stop(0.03, 0.03)
    tolerance: GoalTolerance = GoalTolerance()
    data_sheet: DataSheet = DataSheet()


class Plan(NamedTuple):
    """Solution of a step, the first guess of the next one."""

    unknowns: Array
    """poses and commands"""
    cost: float
    theta: float
    """[rad] heading that the plan started from, continuous"""
    multipliers: tuple[Any, Any]
    """of the bounds and of the constraints"""

    def command(self, periods: int) -> Twist:
        """Return the first command of the plan."""
        v, omega = self.unknowns[3 * (periods + 1) :][:2].tolist()
        return Twist(v, omega)


class NmpcMemory(NamedTuple):
    """Memory of the peers, and the last plan."""

    shared: LawMemory
    plan: Plan | None
    reached: bool


def horizon(config: NmpcConfig) -> Array:
    """Return the lengths (n,) of the periods [s]."""
    lengths: Array = config.period * np.float64(config.growth) ** np.arange(config.periods)
    return lengths


def new_nmpc_memory(config: Any) -> NmpcMemory:
    """Return the memory at rest with a new goal."""
    return NmpcMemory(new_law_memory(), None, False)


def nmpc_step(
    memory: NmpcMemory, estimate: Estimate, goal: Pose, dt: float, config: NmpcConfig
) -> tuple[NmpcMemory, Twist, Report]:
    """One step of the law; after the goal is reached it holds still, as the peers do.

    Raises:
        DiffbotError: if casadi is not installed.
    """
    now = situation_of(memory.shared, estimate, goal, dt, config.data_sheet)
    slow = abs(now.last.v) <= _SLOW_V and abs(now.last.omega) <= _SLOW_OMEGA
    near = now.navigation.rho < config.stop.stop_distance and abs(now.pose.theta) < config.stop.stop_angle
    plan, phase, requested = memory.plan, REACHED, STOP
    if memory.shared.state.phase != REACHED and not (slow and near):
        plan = _first_plan(now, config) if plan is None else _next_plan(plan, now, config)
        phase, requested = DRIVING, plan.command(config.periods)
    shared, command, report = conclude(LawState(phase, 0.0, 0.0), requested, now, config.tolerance, config.data_sheet)
    return NmpcMemory(shared, plan, shared.reached), command, report


def _first_plan(now: Situation, config: NmpcConfig) -> Plan:
    """Return the cheapest of the plans from several first guesses."""
    times = np.concatenate([[0.0], np.cumsum(horizon(config))])
    plans = []
    for guess in GUESSES:
        corners, _ = guessed(now.pose, guess, config.data_sheet)
        corners[:, 3] -= 2.0 * math.pi * round(float(corners[-1, 3]) / (2.0 * math.pi))
        unknowns = np.concatenate([sampled(corners, times).ravel(), np.zeros(2 * config.periods)])
        plans.append(_solved(unknowns, float(corners[0, 3]), now, config, None))
    return min(plans, key=lambda one: one.cost)


def _next_plan(plan: Plan, now: Situation, config: NmpcConfig) -> Plan:
    theta = plan.theta + wrap_angle(now.pose.theta - plan.theta)
    return _solved(plan.unknowns, theta, now, config, plan.multipliers)


def _solved(unknowns: Array, theta: float, now: Situation, config: NmpcConfig, multipliers: Any) -> Plan:
    solver, bounds = _solver(config)
    warm = {} if multipliers is None else {"lam_x0": multipliers[0], "lam_g0": multipliers[1]}
    start = [now.pose.x, now.pose.y, theta, now.last.v, now.last.omega]
    found = solver(x0=unknowns, p=start, **warm, **bounds)
    # A solution that was not finished is used all the same: conclude() keeps the limits.
    solution = np.array(found["x"]).ravel()
    return Plan(solution, float(found["f"]), theta, (found["lam_x"], found["lam_g"]))


@functools.lru_cache(maxsize=16)
def _solver(config: NmpcConfig) -> tuple[Any, dict[str, Any]]:
    """Return the solver and its bounds; parameters are the coasted pose (3,) and the last command (2,)."""
    casadi, sheet, n = load_casadi(), config.data_sheet, config.periods
    poses, commands, given = casadi.SX.sym("X", 3, n + 1), casadi.SX.sym("U", 2, n), casadi.SX.sym("p", 5)
    rows: list[Row] = [(poses[:, 0] - given[:3], 0.0, 0.0)]
    cost, last = 0.0, given[3:]
    for k, h in enumerate(horizon(config).tolist()):
        command, pose = commands[:, k], poses[:, k + 1]
        rows.append((pose - moved(casadi, poses[:, k], command, h), 0.0, 0.0))
        rows += rim_rows(command[0], command[1], sheet)
        for axis, bound in enumerate((sheet.a_max, sheet.omega_dot_max)):
            if bound < math.inf:
                rows.append((command[axis] - last[axis], -bound * h, bound * h))
        distance = casadi.sqrt(pose[0] ** 2 + pose[1] ** 2 + config.eps_xy**2)
        heading = casadi.sqrt(pose[2] ** 2 + config.eps_yaw**2)
        effort = config.effort_weight * (command[0] ** 2 + command[1] ** 2)
        cost, last = cost + h * (distance + config.heading_weight * heading + effort), command
    constraints, low, high = stacked(casadi, rows)
    upper = np.concatenate([np.full(3 * (n + 1), math.inf), np.tile([sheet.v_max, sheet.omega_max], n)])
    program = {"x": casadi.veccat(poses, commands), "p": given, "f": cost, "g": constraints}
    solver = casadi.nlpsol("nmpc", "ipopt", program, _IPOPT)
    return solver, {"lbx": -upper, "ubx": upper, "lbg": low, "ubg": high}


class Nmpc:
    """Receding-horizon control as in J. B. Rawlings, D. Q. Mayne, M. Diehl, Model Predictive Control (2017)."""

    name = "nmpc"
    Config = NmpcConfig
    new_memory = staticmethod(new_nmpc_memory)
    step = staticmethod(nmpc_step)
