"""Limits of the command: bounds of the velocities and of their changes, and the dead bands.

The law ``paper`` scales v and omega by one factor, which keeps the curvature of the path. The law ``switching`` reduces
the speed and keeps the steering, so that dV <= 0 still holds.
"""

from __future__ import annotations

import math

from diffbot_core.data_sheet import DataSheet, rim_speed
from diffbot_core.kinematics import Twist, wheel_speeds

_INF = math.inf
_LIFTED_SHARE = 0.4
"""Below this share of the dead band, a velocity becomes zero; above it, the smallest velocity that moves the robot."""
_ROUNDING = 1.0 + 1e-12
"""Factor on the bounds, so that rounding does not put a command beyond its bound."""


def limit_velocity(command: Twist, data_sheet: DataSheet) -> Twist:
    """Scale ``command`` down until v, omega and both wheel speeds are within bounds; omega / v does not change."""
    scale = 1.0
    if abs(command.v) > data_sheet.v_max:
        scale = data_sheet.v_max / abs(command.v)
    if abs(command.omega) * scale > data_sheet.omega_max:
        scale = data_sheet.omega_max / abs(command.omega)
    wheels = wheel_speeds(command, data_sheet.wheels)
    fastest = max(abs(wheels.left), abs(wheels.right))
    if fastest * scale > data_sheet.wheel_max:
        scale = data_sheet.wheel_max / fastest
    return Twist(command.v * scale, command.omega * scale)


def limit_acceleration(command: Twist, previous: Twist, dt: float, data_sheet: DataSheet) -> Twist:
    """Return the twist on the curve of ``command`` that the robot can reach from ``previous`` within ``dt`` [s].

    The result is s * command, with the largest factor s in [0, 1] for which neither velocity changes by more than its
    bound times dt. So the path keeps its curvature, and only the timing changes. While the robot still moves along
    another curve, such a factor may not exist. Then each velocity changes towards the command by itself, see
    :func:`limit_change`.
    """
    if data_sheet.a_max == _INF and data_sheet.omega_dot_max == _INF:
        return command
    dv, domega = _changes(dt, data_sheet)
    low_v, high_v = _factors(command.v, previous.v, dv)
    low_w, high_w = _factors(command.omega, previous.omega, domega)
    low = max(low_v, low_w, 0.0)
    high = min(high_v, high_w, 1.0)
    if low <= high:
        return Twist(command.v * high, command.omega * high)
    return limit_change(command, previous, dt, data_sheet)


def _changes(dt: float, data_sheet: DataSheet) -> tuple[float, float]:
    """Return the largest changes of v [m/s] and omega [rad/s] within ``dt`` [s]; inf without a limit, even for 0 s."""
    dv = data_sheet.a_max * dt if data_sheet.a_max < _INF else _INF
    domega = data_sheet.omega_dot_max * dt if data_sheet.omega_dot_max < _INF else _INF
    return dv, domega


def _factors(requested: float, previous: float, change: float) -> tuple[float, float]:
    """Return the interval of s for which |s * requested - previous| <= change; (1, 0) if it is empty."""
    if requested == 0.0:
        return (-_INF, _INF) if abs(previous) <= change else (1.0, 0.0)
    one = (previous - change) / requested
    other = (previous + change) / requested
    return min(one, other), max(one, other)


def _towards(requested: float, previous: float, change: float) -> float:
    return min(max(requested, previous - change), previous + change)


def limit_change(command: Twist, previous: Twist, dt: float, data_sheet: DataSheet) -> Twist:
    """Change each velocity from ``previous`` towards ``command`` as far as ``dt`` [s] allows, within all bounds.

    If the faster rim exceeds its bound, the speed is reduced first, as far as ``dt`` allows, and then the rotation. A
    bound that is lowered while the robot drives may be out of reach. Then the result brakes as hard as the
    accelerations allow.
    """
    if data_sheet.a_max == _INF and data_sheet.omega_dot_max == _INF:
        return command
    dv, domega = _changes(dt, data_sheet)
    rim, half = rim_speed(data_sheet), 0.5 * data_sheet.wheels.wheel_separation
    v = _towards(_clip(command.v, data_sheet.v_max), previous.v, dv)
    omega = _towards(_clip(command.omega, data_sheet.omega_max), previous.omega, domega)
    if abs(v) + half * abs(omega) > rim:
        v = _clip(v, max(rim - half * abs(omega), abs(previous.v) - dv, 0.0))
        # The second bound matters only if the rim is still too fast, because a rotation cannot end at once.
        omega = _clip(omega, max((rim - abs(v)) / half, abs(previous.omega) - domega, 0.0))
    return Twist(v, omega)


def slowed(previous: Twist, dt: float, data_sheet: DataSheet) -> Twist:
    """Return the command after braking from ``previous`` on the same curve for ``dt`` [s], as hard as the limits allow.

    A velocity beyond a bound that was lowered while the robot drives leaves the curve: see :func:`limit_change`.
    """
    dv, domega = _changes(dt, data_sheet)
    left = 0.0
    if abs(previous.v) > dv:
        left = 1.0 - dv / abs(previous.v)
    if abs(previous.omega) > domega:
        left = max(left, 1.0 - domega / abs(previous.omega))
    slower = Twist(left * previous.v, left * previous.omega)
    return limit_change(slower, previous, dt, data_sheet) if is_beyond(slower, data_sheet) else slower


def is_beyond(command: Twist, data_sheet: DataSheet) -> bool:
    """Return True if a command exceeds a bound of the velocities by more than rounding."""
    rim, half = rim_speed(data_sheet), 0.5 * data_sheet.wheels.wheel_separation
    return (
        abs(command.v) > data_sheet.v_max * _ROUNDING
        or abs(command.omega) > data_sheet.omega_max * _ROUNDING
        or abs(command.v) + half * abs(command.omega) > rim * _ROUNDING
    )


def limit_global(phi: float, v: float, turn: float, data_sheet: DataSheet) -> Twist:
    """Return (s v, phi + s turn) within the bounds of the velocities, with the largest possible s in [0, 1].

    The steering keeps its rate phi, and the speed is reduced. In Omega_G, dV is linear in the command, and each command
    (s v, q phi + s turn) with s, q >= 0 has dV <= 0. So dV <= 0 also holds for the limited command.

    Args:
        phi: [rad/s] steering to the goal, clipped to the bound of a rotation on the spot.
        v: [m/s].
        turn: [rad/s] rotation that the path requires at the speed v.
        data_sheet: bounds of the robot.
    """
    if data_sheet.min_velocity > 0.0 or data_sheet.min_rotation > 0.0:
        phi, v, turn = _lifted_parts(phi, v, turn, data_sheet)
    v_max, omega_max = data_sheet.v_max, data_sheet.omega_max
    rim, half = rim_speed(data_sheet), 0.5 * data_sheet.wheels.wheel_separation
    phi = _clip(phi, min(omega_max, rim / half))
    speed = abs(v)
    s = 1.0 if speed <= v_max else v_max / speed
    if abs(phi + s * turn) > omega_max:
        room = omega_max - phi if turn > 0.0 else omega_max + phi
        s = min(s, room / abs(turn))
    # The bound of the rims, for both signs of phi + s turn; s = 0 always keeps it.
    up, down = speed + half * turn, speed - half * turn
    if half * phi + s * up > rim and up > 0.0:
        s = (rim - half * phi) / up
    if s * down - half * phi > rim and down > 0.0:
        s = (rim + half * phi) / down
    s = max(s, 0.0)
    return Twist(s * v, phi + s * turn)


def limit_local(command: Twist, data_sheet: DataSheet) -> Twist:
    """Return a command of Omega_L within the bounds of the velocities; the rotation has priority over the speed.

    In Omega_L, dV has a separate term for each velocity, so each velocity may be reduced by itself.
    """
    v, omega = lifted_command(command, data_sheet)
    rim, half = rim_speed(data_sheet), 0.5 * data_sheet.wheels.wheel_separation
    omega = _clip(omega, min(data_sheet.omega_max, rim / half))
    return Twist(_clip(v, min(data_sheet.v_max, max(rim - half * abs(omega), 0.0))), omega)


def lifted(value: float, dead_band: float) -> float:
    """Replace a velocity below ``dead_band``, which does not move the robot, by zero or by ``dead_band``."""
    if abs(value) >= dead_band:
        return value
    return math.copysign(dead_band, value) if abs(value) > _LIFTED_SHARE * dead_band else 0.0


def lifted_command(command: Twist, data_sheet: DataSheet) -> Twist:
    """Lift each velocity of a command out of its dead band, see :func:`lifted`."""
    if data_sheet.min_velocity <= 0.0 and data_sheet.min_rotation <= 0.0:
        return command
    return Twist(lifted(command.v, data_sheet.min_velocity), lifted(command.omega, data_sheet.min_rotation))


def _lifted_parts(phi: float, v: float, turn: float, data_sheet: DataSheet) -> tuple[float, float, float]:
    """Lift the command (v, phi + turn) out of the dead bands; v and turn keep their ratio."""
    if data_sheet.min_velocity > 0.0 and v != 0.0:
        factor = lifted(v, data_sheet.min_velocity) / v
        v, turn = factor * v, factor * turn
    if data_sheet.min_rotation > 0.0:
        phi = lifted(phi + turn, data_sheet.min_rotation) - turn
    return phi, v, turn


def _clip(value: float, bound: float) -> float:
    return min(max(value, -bound), bound)
