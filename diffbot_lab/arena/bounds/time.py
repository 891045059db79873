"""The time-optimal drive: free final time, direct multiple shooting, CasADi with Ipopt.

Unknown are the poses at the ends of all periods, the commands held over them and the length of a period. The least
time until the robot is inside the target for good is found from several first guesses, since the problem is not
convex; what counts is checked by the plant afterwards (:func:`bound_drive.arrives`).
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from diffbot_core.data_sheet import DataSheet
from diffbot_core.geometry import Pose
from diffbot_lab.arena.bounds.drive import GUESSES, Drive, Target, arrives, guessed, path_of, sampled
from diffbot_lab.arena.bounds.model import QUIET, Row, load_casadi, moved, rim_rows, stacked
from diffbot_sim.model.plant import PlantConfig

Array = NDArray[np.float64]

PERIOD = 0.1
"""[s] of the first guess, the arena's sampling time; the optimum has periods close to it"""
BRAKING = 12
"""periods in which a robot with bounded acceleration comes to rest inside the target"""
_MIN_PERIODS = 20
_MARGIN = 1e-5
"""[m], [rad] by which the solver's target is smaller than that of the check"""
_IPOPT = {
    **QUIET,
    "ipopt.tol": 1e-6,
    "ipopt.constr_viol_tol": 1e-8,
    "ipopt.max_iter": 500,
}


class Found(NamedTuple):
    """The best drive from one start."""

    drive: Drive
    guess: str
    """from which it was found"""


def fastest_drive(start: Pose, plant: PlantConfig, sheet: DataSheet, target: Target) -> Found | None:
    """Return the fastest drive from rest at ``start`` into ``target`` that the plant confirms; None if there is none.

    Raises:
        DiffbotError: if casadi is not installed.
    """
    best: Found | None = None
    for guess in GUESSES:
        drive = _solved(start, guessed(start, guess, sheet)[0], sheet, target)
        if drive is None or not arrives(start, drive, plant, sheet, target):
            continue
        if best is None or drive.time < best.drive.time:
            best = Found(drive, guess)
    if best is None:
        return None
    # Again from the optimum, with periods of the arena's sampling time.
    path = path_of(start, best.drive.commands, best.drive.period)
    corners = np.column_stack((np.arange(len(path)) * best.drive.period, path))[: best.drive.arrival + 1]
    drive = _solved(start, corners, sheet, target)
    if drive is None or not arrives(start, drive, plant, sheet, target):
        return best
    return Found(drive, best.guess)


def _solved(start: Pose, corners: Array, sheet: DataSheet, target: Target) -> Drive | None:
    """Return the local optimum next to a guess (n, 4), see :func:`guessed`; None if the solver finds none."""
    casadi = load_casadi()
    total = float(corners[-1, 0])
    arrival = max(math.ceil(total / PERIOD - 1e-9), _MIN_PERIODS)
    bounded = sheet.a_max < math.inf or sheet.omega_dot_max < math.inf
    periods = arrival + (BRAKING if bounded and not target.at_rest else 0)
    end = 2.0 * math.pi * round(float(corners[-1, 3]) / (2.0 * math.pi))
    problem, bounds = _problem(casadi, sheet, target, (periods, arrival))
    solver = casadi.nlpsol("drive", "ipopt", problem, _IPOPT)
    poses = sampled(corners, np.arange(periods + 1) * total / arrival)
    x0 = np.concatenate([[total / arrival], poses.ravel(), np.zeros(2 * periods)])
    found = solver(x0=x0, p=[*start, end], **bounds)
    if not solver.stats()["success"]:
        return None
    x = np.array(found["x"]).ravel()
    return Drive(x[1 + 3 * (periods + 1) :].reshape(periods, 2), float(x[0]), arrival)


def _problem(casadi: Any, sheet: DataSheet, target: Target, size: tuple[int, int]) -> tuple[dict[str, Any], Any]:
    """Return the nonlinear program and its bounds; parameters are the start (3,) and the goal's heading [rad]."""
    periods, arrival = size
    period, poses = casadi.SX.sym("h"), casadi.SX.sym("X", 3, periods + 1)
    commands, given = casadi.SX.sym("U", 2, periods), casadi.SX.sym("p", 4)
    rows: list[Row] = [(poses[:, 0] - given[:3], 0.0, 0.0)]
    for k in range(periods):
        rows.append((poses[:, k + 1] - moved(casadi, poses[:, k], commands[:, k], period), 0.0, 0.0))
    rows += _limits(casadi, commands, period, periods, sheet)
    for k in range(arrival, periods + 1):
        pose, xy, yaw = poses[:, k], max(target.xy - _MARGIN, 0.0), max(target.yaw - _MARGIN, 0.0)
        rows.append((pose[0] ** 2 + pose[1] ** 2, -math.inf, xy * xy))
        rows.append((pose[2] - given[3], -yaw, yaw))
    constraints, low, high = stacked(casadi, rows)
    free = np.full(3 * (periods + 1), math.inf)
    upper = np.concatenate([[5.0 * PERIOD], free, np.tile([sheet.v_max, sheet.omega_max], periods)])
    lower = -upper
    lower[0] = 1e-3
    program = {"x": casadi.veccat(period, poses, commands), "p": given, "f": arrival * period, "g": constraints}
    return program, {"lbx": lower, "ubx": upper, "lbg": low, "ubg": high}


def _limits(casadi: Any, commands: Any, period: Any, periods: int, sheet: DataSheet) -> list[Row]:
    """Return the limits of rims and accelerations as rows (expression, low, high); at first and at last it rests."""
    rows = rim_rows(commands[0, :].T, commands[1, :].T, sheet)
    rest = casadi.SX.zeros(2, 1)
    changes = casadi.horzcat(commands, rest) - casadi.horzcat(rest, commands)
    for axis, bound in enumerate((sheet.a_max, sheet.omega_dot_max)):
        if bound < math.inf:
            rows.append((changes[axis, :].T - bound * period, -math.inf, 0.0))
            rows.append((changes[axis, :].T + bound * period, 0.0, math.inf))
    return rows
