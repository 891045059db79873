"""Limits of the command that keep the curvature of the path: both velocities shrink by one factor."""

from __future__ import annotations

import math
from typing import Annotated, NamedTuple

from diffbot_core.kinematics import Twist, WheelGeometry, wheel_speeds
from diffbot_core.schema import Spec

_INF = math.inf


class Limits(NamedTuple):
    """Bounds of the command; ``inf`` is no limit. Parameter names are those of diff_drive_controller."""

    v_max: Annotated[
        float,
        Spec(
            "bound of |v|",
            "m/s",
            minimum=0.0,
            exclusive_minimum=True,
            allow_inf=True,
            parameter="linear.x.max_velocity",
        ),
    ] = 1.3
    omega_max: Annotated[
        float,
        Spec(
            "bound of |omega|",
            "rad/s",
            minimum=0.0,
            exclusive_minimum=True,
            allow_inf=True,
            parameter="angular.z.max_velocity",
        ),
    ] = _INF
    wheel_max: Annotated[
        float,
        Spec(
            "bound of each wheel's |speed|",
            "rad/s",
            minimum=0.0,
            exclusive_minimum=True,
            allow_inf=True,
            parameter="wheel.max_velocity",
        ),
    ] = _INF
    a_max: Annotated[
        float,
        Spec(
            "bound of |dv/dt|",
            "m/s^2",
            minimum=0.0,
            exclusive_minimum=True,
            allow_inf=True,
            parameter="linear.x.max_acceleration",
        ),
    ] = _INF
    omega_dot_max: Annotated[
        float,
        Spec(
            "bound of |domega/dt|",
            "rad/s^2",
            minimum=0.0,
            exclusive_minimum=True,
            allow_inf=True,
            parameter="angular.z.max_acceleration",
        ),
    ] = _INF


def limit_velocity(command: Twist, limits: Limits, geometry: WheelGeometry) -> Twist:
    """Scale ``command`` down until v, omega and both wheel speeds are within bounds; omega / v does not change."""
    scale = 1.0
    if abs(command.v) > limits.v_max:
        scale = limits.v_max / abs(command.v)
    if abs(command.omega) * scale > limits.omega_max:
        scale = limits.omega_max / abs(command.omega)
    wheels = wheel_speeds(command, geometry)
    fastest = max(abs(wheels.left), abs(wheels.right))
    if fastest * scale > limits.wheel_max:
        scale = limits.wheel_max / fastest
    return Twist(command.v * scale, command.omega * scale)


def limit_acceleration(command: Twist, previous: Twist, dt: float, limits: Limits) -> Twist:
    """Return the twist nearest to ``command`` that can be reached from ``previous`` within ``dt`` [s].

    It is s * command with the largest factor s in [0, 1] that changes neither velocity by more than its bound times dt:
    the path keeps its curvature, and only the timing changes. If there is no such factor (the robot still moves along
    another curve), each velocity moves towards the command as far as its bound allows.
    """
    if limits.a_max == _INF and limits.omega_dot_max == _INF:
        return command
    # An absent limit must stay absent for dt = 0: inf * 0 is not a number.
    dv = limits.a_max * dt if limits.a_max < _INF else _INF
    domega = limits.omega_dot_max * dt if limits.omega_dot_max < _INF else _INF
    low_v, high_v = _factors(command.v, previous.v, dv)
    low_w, high_w = _factors(command.omega, previous.omega, domega)
    low = max(low_v, low_w, 0.0)
    high = min(high_v, high_w, 1.0)
    if low <= high:
        return Twist(command.v * high, command.omega * high)
    return Twist(_towards(command.v, previous.v, dv), _towards(command.omega, previous.omega, domega))


def _factors(requested: float, previous: float, change: float) -> tuple[float, float]:
    """Interval of s for which |s * requested - previous| <= change; empty (1, 0) if there is none."""
    if requested == 0.0:
        return (-_INF, _INF) if abs(previous) <= change else (1.0, 0.0)
    one = (previous - change) / requested
    other = (previous + change) / requested
    return min(one, other), max(one, other)


def _towards(requested: float, previous: float, change: float) -> float:
    return min(max(requested, previous - change), previous + change)
