"""A law of your own: turn towards the goal, drive there, turn to its heading, with three gains.

Any module that Python finds may hold one; nothing has to be registered::

    PYTHONPATH=docs/examples diffbot benchmark --runs 20 --law straight_line:StraightLine

A package registers its laws by name: entry points in the group ``diffbot.controllers``. The functions use floats and
named tuples only, so they are compiled; if numba cannot compile a law, it runs as plain Python, and a line says so.
"""

from __future__ import annotations

import math
from typing import Annotated, NamedTuple

from diffbot_control.law import Report
from diffbot_core.data_sheet import DataSheet
from diffbot_core.geometry import Pose, into_frame, wrap_angle
from diffbot_core.kinematics import Twist
from diffbot_core.schema import Spec
from diffbot_core.uncertainty import Estimate


class Config(NamedTuple):
    """Parameters, with text, unit and range; the data sheet brings the limits of the robot."""

    distance_gain: Annotated[float, Spec("speed per distance", "1/s", 0.1, 10.0)] = 1.0
    turn_gain: Annotated[float, Spec("rate per angle", "1/s", 0.1, 10.0)] = 2.0
    stop_distance: Annotated[float, Spec("below it the robot turns to the goal's heading", "m", 0.001, 1.0)] = 0.04
    data_sheet: DataSheet = DataSheet()


class Memory(NamedTuple):
    """What one step passes to the next; ``reached`` has a fixed meaning, the rest is the law's own."""

    arrived: bool
    reached: bool


def new_memory(config: Config) -> Memory:
    """Return the memory with a new goal; compiled code does not know defaults, so every field is given."""
    return Memory(False, False)


def step(memory: Memory, estimate: Estimate, goal: Pose, dt: float, config: Config) -> tuple[Memory, Twist, Report]:
    """Answer an estimate with the next memory, a command and a report."""
    local = into_frame(estimate.pose, goal)
    rho, beta = math.hypot(local.x, local.y), math.atan2(-local.y, -local.x)
    alpha = wrap_angle(beta - local.theta)
    arrived = memory.arrived or rho < config.stop_distance
    angle = -local.theta if arrived else alpha
    v = 0.0 if arrived else config.distance_gain * rho * max(math.cos(alpha), 0.0)
    command = limited(v, config.turn_gain * angle, config.data_sheet)
    reached = memory.reached or (arrived and abs(local.theta) < 0.03)
    if reached:
        command = Twist(0.0, 0.0)
    return Memory(arrived, reached), command, Report(rho, alpha, beta, local.theta, 0.0, 0, 0.0)


def limited(v: float, omega: float, sheet: DataSheet) -> Twist:
    """Scale a command down to the limits of speed; both axes alike, so that the curvature stays."""
    rim = abs(v) + 0.5 * sheet.wheels.wheel_separation * abs(omega)
    scale = max(
        1.0,
        abs(v) / sheet.v_max,
        abs(omega) / sheet.omega_max,
        rim / (sheet.wheel_max * sheet.wheels.wheel_radius),
    )
    return Twist(v / scale, omega / scale)


class StraightLine:
    """The law: a name, a configuration type, and two functions."""

    name = "straight_line"
    Config = Config
    new_memory = staticmethod(new_memory)
    step = staticmethod(step)
