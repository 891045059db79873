"""Drives without noise to the goal: first guesses, their least times in closed form, and the check by the plant.

All drives hold a command over each sampling period, as the arena's robot does. A robot with bounded acceleration may
change its command at once, too, by as much as it may within a period; so it is one period faster than one whose
velocity changes continuously.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from diffbot_control.law.limits import limit_velocity
from diffbot_core.data_sheet import DataSheet, leg_times
from diffbot_core.geometry import Pose, straight_legs, wrap_angle
from diffbot_core.kinematics import Twist
from diffbot_lab.arena.cases import XY_TOLERANCE, YAW_TOLERANCE
from diffbot_sim.model.philox import Draw
from diffbot_sim.model.plant import PlantConfig, integrate, new_plant, plant_step

Array = NDArray[np.float64]

FORWARDS, BACKWARDS, STRAIGHT = "forwards", "backwards", "straight"
GUESSES = (FORWARDS, BACKWARDS, STRAIGHT)
"""Turn, drive, turn in either direction of travel; pose interpolated between start and goal"""
ROUNDING = 1e-6
"""relative; a command beyond a bound by less is the solver's rounding"""
_NO_NOISE = Draw(0.0, 0.0, 0.0, 0.0)


class Target(NamedTuple):
    """Where a drive has to end, about the origin."""

    name: str
    xy: float
    """[m]"""
    yaw: float
    """[rad]"""
    at_rest: bool
    """the robot arrives at rest; otherwise it may brake inside"""


INTO_TOLERANCE = Target("into the tolerance", XY_TOLERANCE, YAW_TOLERANCE, at_rest=False)
AT_THE_POSE = Target("at rest at the pose", 1e-3, 1e-3, at_rest=True)


class Drive(NamedTuple):
    """Commands that lead to the goal."""

    commands: Array
    """(n, 2) v, omega [m/s, rad/s], each held for ``period``"""
    period: float
    """[s]"""
    arrival: int
    """periods until the robot is inside for good; in the others, if any, it brakes there"""

    @property
    def time(self) -> float:
        """Time of the arrival [s]."""
        return self.arrival * self.period


def guessed(start: Pose, guess: str, sheet: DataSheet) -> tuple[Array, float]:
    """Return a first guess as corners (n, 4) of time [s], x, y, theta, and its duration [s]; the goal is the origin.

    The heading is continuous, so it ends at a multiple of 2 pi.
    """
    x, y, theta = start
    if guess == STRAIGHT:
        turn = wrap_angle(-theta)
        turning, driving, _ = leg_times(turn, math.hypot(x, y), 0.0, sheet)
        total = driving + turning
        return np.array([(0.0, x, y, theta), (total, 0.0, 0.0, theta + turn)]), total
    first, way, last = straight_legs(start, backwards=guess == BACKWARDS)
    before, drive, after = leg_times(first, way, last, sheet)
    corners = [(0.0, x, y, theta), (before, x, y, theta + first), (before + drive, 0.0, 0.0, theta + first)]
    total = before + drive + after
    return np.array([*corners, (total, 0.0, 0.0, theta + first + last)]), total


def sampled(corners: Array, times: Array) -> Array:
    """Return the poses (n, 3) of a guess at ``times`` [s]; after its end it stays."""
    return np.column_stack([np.interp(times, corners[:, 0], column) for column in corners.T[1:]])


def path_of(start: Pose, commands: Array, period: float) -> Array:
    """Return the poses (n + 1, 3) along commands (n, 2) that are held for ``period`` [s]; the heading is continuous."""
    poses, turned, pose = [start], start.theta, start
    for v, omega in commands.tolist():
        pose = integrate(pose, Twist(v, omega), period, True)
        turned += omega * period
        poses.append(Pose(pose.x, pose.y, turned))
    return np.array(poses, dtype=np.float64)


def arrives(start: Pose, drive: Drive, plant: PlantConfig, sheet: DataSheet, target: Target) -> bool:
    """Return True if the plant without noise follows the commands into the target and rests there.

    The plant takes each command through its actuators (acceleration limits, saturation). They must not change one: a
    drive counts only if it keeps all limits itself. From the arrival on the pose has to stay inside.
    """
    quiet = plant._replace(drive_noise=0.0, encoder_noise=0.0, sampling_time=drive.period)
    state = new_plant(start)
    inside = [_inside(state.pose, target)]
    for v, omega in [*drive.commands.tolist(), (0.0, 0.0)]:
        command = Twist(v, omega)
        if not _allowed(command, sheet):
            return False
        state = plant_step(state, command, _NO_NOISE, quiet)
        if abs(state.twist.v - v) > ROUNDING or abs(state.twist.omega - omega) > ROUNDING:
            return False
        inside.append(_inside(state.pose, target))
    return all(inside[drive.arrival :])


def _allowed(command: Twist, sheet: DataSheet) -> bool:
    limited = limit_velocity(command, sheet)
    return math.isclose(limited.v, command.v, rel_tol=ROUNDING) and math.isclose(
        limited.omega, command.omega, rel_tol=ROUNDING
    )


def _inside(pose: Pose, target: Target) -> bool:
    return math.hypot(pose.x, pose.y) <= target.xy and abs(wrap_angle(pose.theta)) <= target.yaw
