"""Latency and lag, compensated for all laws alike: the pose in which the robot would come to rest.

In the coasted pose a command acts at once: with z = x + T x' and T x'' + x' = u, the lag T gives z' = u, and commands
under way are integrated. All laws call it here.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from diffbot_core.data_sheet import DataSheet
from diffbot_core.geometry import Pose, wrap_angle
from diffbot_core.kinematics import Twist

SLOTS = 8
"""commands kept; a latency of more sampling times than that is compensated in part"""


class UnderWay(NamedTuple):
    """Commands that have not acted yet, and what the wheels do."""

    motion: Twist
    """of the wheels by the model"""
    commands: tuple[Twist, Twist, Twist, Twist, Twist, Twist, Twist, Twist]
    """the newest last"""


def nothing_under_way() -> UnderWay:
    """Return the state at rest."""
    rest = Twist(0.0, 0.0)
    return UnderWay(rest, (rest, rest, rest, rest, rest, rest, rest, rest))


def sent(state: UnderWay, command: Twist) -> UnderWay:
    """Return the state with one more command."""
    c = state.commands
    return UnderWay(state.motion, (c[1], c[2], c[3], c[4], c[5], c[6], c[7], command))


def _steps(latency: float, dt: float) -> int:
    return min(max(math.ceil(latency / dt - 1e-9), 0), SLOTS - 1)


def moved(state: UnderWay, dt: float, sheet: DataSheet) -> UnderWay:
    """Return the state ``dt`` [s] later: the wheels follow the commands with a first-order lag."""
    lag = sheet.drive_time_constant
    if lag <= 0.0 or dt <= 0.0:
        return state
    n = _steps(sheet.command_latency, dt)
    span = min(max(sheet.command_latency - (n - 1) * dt, 0.0), dt) if n > 0 else dt
    motion = _approached(state.motion, state.commands[SLOTS - n - 1], span / lag)
    if n > 0:
        motion = _approached(motion, state.commands[SLOTS - n], (dt - span) / lag)
    return UnderWay(motion, state.commands)


def _approached(motion: Twist, command: Twist, time: float) -> Twist:
    """Return the motion after ``time`` [time constants] under a command."""
    left = math.exp(-time)
    return Twist(command.v + (motion.v - command.v) * left, command.omega + (motion.omega - command.omega) * left)


def coasted(pose: Pose, state: UnderWay, dt: float, sheet: DataSheet) -> Pose:
    """Return the pose in which the robot would come to rest if zero were commanded from now on.

    Args:
        pose: [m, m, rad] of the robot, in any frame.
        state: commands under way and motion of the wheels.
        dt: [s] sampling time; 0 at the first step, which changes nothing.
        sheet: latency and lag.
    """
    latency, lag = sheet.command_latency, sheet.drive_time_constant
    if dt <= 0.0 or (latency <= 0.0 and lag <= 0.0):
        return pose
    motion = state.motion
    n = _steps(latency, dt)
    span = min(max(latency - (n - 1) * dt, 0.0), dt)
    for age in range(n, 0, -1):
        command = state.commands[SLOTS - age]
        distance, turn = command.v * span, command.omega * span
        if lag > 0.0:
            after = _approached(motion, command, span / lag)
            distance += lag * (motion.v - after.v)
            turn += lag * (motion.omega - after.omega)
            motion = after
        pose = _along_arc(pose, distance, turn)
        span = dt
    return _along_arc(pose, motion.v * lag, motion.omega * lag) if lag > 0.0 else pose


def _along_arc(pose: Pose, distance: float, turn: float) -> Pose:
    half = 0.5 * turn
    chord = distance * (math.sin(half) / half if abs(half) > 1e-2 else 1.0 - half * half / 6.0)
    x = pose.x + chord * math.cos(pose.theta + half)
    y = pose.y + chord * math.sin(pose.theta + half)
    return Pose(x, y, wrap_angle(pose.theta + turn))
