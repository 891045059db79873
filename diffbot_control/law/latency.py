"""Dead time and lag: predict the pose in which the robot would come to rest, from the commands that still act.

The law works with the *coasted pose*, in which the robot would come to rest if zero were commanded from now on. It
follows a first-order lag behind a dead time, x' + lag x'' = command. In z = x + lag x' (after the dead time) that is
z' = command: neither dead time nor lag remains in the loop, exactly on a line, and to first order on a curve.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from diffbot_core.data_sheet import DataSheet
from diffbot_core.geometry import Pose, wrap_angle
from diffbot_core.kinematics import Twist
from diffbot_core.uncertainty import Estimate, Uncertainty

SLOTS = 8
"""Number of commands that are kept. At a fast rate or a long latency, neighbouring commands are merged into their mean,
which moves the robot as far; any two neighbours span more than a quarter of the time that has to be covered."""
_SHORTEST = 1e-9
"""[s] a shorter span is a rounding error"""
_MOTION_ERROR = 0.05
"""bound of the relative error of a commanded motion, which +-5 % per wheel causes"""
_STRAIGHT = 0.01
"""[rad] if half the turn is smaller, sin(a) / a is computed from its series, which is exact to 1e-11"""


class Held(NamedTuple):
    """A command and the time for which it was in force."""

    v: float
    """[m/s]"""
    omega: float
    """[rad/s]"""
    span: float
    """[s]"""


_NOTHING = Held(0.0, 0.0, 0.0)
UnderWay = tuple[Held, Held, Held, Held, Held, Held, Held, Held]


class Actuation(NamedTuple):
    """Motion of the robot at the last pose, and commands before; the default is at rest."""

    motion: Twist = Twist(0.0, 0.0)
    """velocities by the model of the drives"""
    under_way: UnderWay = (_NOTHING,) * SLOTS  # type: ignore[assignment]
    """commands before the last one, the oldest first"""


class Coasted(NamedTuple):
    """Prediction of the pose at rest."""

    actuation: Actuation
    pose: Pose
    way: float
    """[m] length driven until then, forwards and backwards"""
    turn: float
    """[rad] angle turned until then, to the left and to the right"""


def resting_actuation() -> Actuation:
    """Return the state at rest, with every field given, because compiled code does not know the defaults."""
    none = Held(0.0, 0.0, 0.0)
    return Actuation(Twist(0.0, 0.0), (none, none, none, none, none, none, none, none))


def is_immediate(data_sheet: DataSheet) -> bool:
    """True if the robot has neither dead time nor lag."""
    return data_sheet.command_latency <= 0.0 and data_sheet.drive_time_constant <= 0.0


def remembered(under_way: UnderWay, command: Twist, dt: float, data_sheet: DataSheet) -> UnderWay:
    """Add ``command``, which was in force for the last ``dt`` [s]."""
    if dt <= 0.0:
        return under_way
    newest = under_way[SLOTS - 1]
    span = newest.span + dt
    if span > (data_sheet.command_latency + dt) * (2.0 / SLOTS):
        return (*under_way[1:], Held(command.v, command.omega, dt))
    share = dt / span
    joined = Held(
        newest.v + share * (command.v - newest.v), newest.omega + share * (command.omega - newest.omega), span
    )
    return (*under_way[:-1], joined)


def coast(pose: Pose, actuation: Actuation, command: Twist, dt: float, data_sheet: DataSheet) -> Coasted:
    """Predict where the robot comes to rest if zero is commanded from now on.

    Args:
        pose: now.
        actuation: result of the last pose.
        command: the last command, in force for the last ``dt``.
        dt: [s] since the last pose.
        data_sheet: dead time and time constant.
    """
    under_way = remembered(actuation.under_way, command, dt, data_sheet)
    lag, latency = data_sheet.drive_time_constant, data_sheet.command_latency
    motion = actuation.motion if lag <= 0.0 else _motion_after(actuation.motion, under_way, dt, data_sheet)
    (v, omega), (x, y, theta) = motion, pose
    way = turned = 0.0
    first, skipped, _ = _since(under_way, latency)
    for index in range(first, SLOTS):
        held_v, held_omega, span = under_way[index]
        span, skipped = span - skipped, 0.0
        forward, turn = held_v * span, held_omega * span
        if lag > 0.0:
            left = math.exp(-span / lag)
            dv, domega, gone = v - held_v, omega - held_omega, lag * (1.0 - left)
            forward, turn = forward + dv * gone, turn + domega * gone
            v, omega = held_v + dv * left, held_omega + domega * left
        # As _moved, written out because this loop runs at each pose.
        half = 0.5 * turn
        if half > _STRAIGHT or half < -_STRAIGHT:
            chord = forward * math.sin(half) / half
        else:
            chord = forward * (1.0 - half * half / 6.0)
        middle = theta + half
        x += chord * math.cos(middle)
        y += chord * math.sin(middle)
        theta += turn
        way, turned = way + abs(forward), turned + abs(turn)
    if lag > 0.0:
        x, y, theta = _moved(x, y, theta, v * lag, omega * lag)
        way, turned = way + abs(v) * lag, turned + abs(omega) * lag
    return Coasted(Actuation(motion, under_way), Pose(x, y, wrap_angle(theta)), way, turned)


def _since(under_way: UnderWay, age: float) -> tuple[int, float, float]:
    """Return index and elapsed time [s] of the command ``age`` [s] ago, and the time [s] before the first command."""
    first, missing = SLOTS, age
    while missing > _SHORTEST and first > 0:
        first -= 1
        missing -= under_way[first].span
    return first, max(-missing, 0.0), max(missing, 0.0)


def after_a_period(actuation: Actuation, command: Twist, dt: float, data_sheet: DataSheet) -> Actuation:
    """Return the actuation one period later without a law, while the robot brakes; see :func:`coast`."""
    return coast(Pose(0.0, 0.0, 0.0), actuation, command, dt, data_sheet).actuation


def _motion_after(motion: Twist, under_way: UnderWay, dt: float, data_sheet: DataSheet) -> Twist:
    """Return the motion ``dt`` [s] after ``motion``; before the first command the robot rested."""
    lag = data_sheet.drive_time_constant
    index, skipped, missing = _since(under_way, data_sheet.command_latency + dt)
    v, omega = motion
    to_go = dt - missing
    while to_go > _SHORTEST and index < SLOTS:
        held = under_way[index]
        span = min(held.span - skipped, to_go)
        left = math.exp(-span / lag)
        v, omega = held.v + (v - held.v) * left, held.omega + (omega - held.omega) * left
        to_go -= span
        skipped = 0.0
        index += 1
    return Twist(v, omega)


def _moved(x: float, y: float, theta: float, forward: float, turn: float) -> tuple[float, float, float]:
    """Return the end of an arc of length ``forward`` [m] that turns by ``turn`` [rad]."""
    half = 0.5 * turn
    chord = forward * (math.sin(half) / half if abs(half) > _STRAIGHT else 1.0 - half * half / 6.0)
    middle = theta + half
    return x + chord * math.cos(middle), y + chord * math.sin(middle), theta + turn


def predicted(coasted: Coasted, uncertainty: Uncertainty) -> Estimate:
    """Return the estimate of the coasted pose; the predicted motion has a relative error that is uniform in +-5 %."""
    way, turn = coasted.way, coasted.turn
    if way <= 0.0 and turn <= 0.0:
        return Estimate(coasted.pose, uncertainty)
    deviation = _MOTION_ERROR / math.sqrt(3.0)
    along, across = deviation * way, uncertainty.theta * way
    return Estimate(
        coasted.pose,
        Uncertainty(
            math.sqrt(uncertainty.xy * uncertainty.xy + along * along + across * across),
            math.hypot(uncertainty.theta, deviation * turn),
        ),
    )
