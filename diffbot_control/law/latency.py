"""Dead time and lag: predict the pose in which the robot would come to rest, from the commands that still act.

The drives are modelled as a first-order lag behind a dead time: x' + lag x'' = command. The law works with the *coasted
pose*, in which the robot would come to rest if zero were commanded from now on. This is z = x + lag x' at the end of
the dead time, and z' = command. So neither dead time nor lag remains in the control loop. On a straight line this is
exact, and on a curve it holds to first order.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from diffbot_core.data_sheet import DataSheet
from diffbot_core.geometry import Pose, wrap_angle
from diffbot_core.kinematics import Twist
from diffbot_core.uncertainty import Estimate, Uncertainty

SLOTS = 8
"""Number of commands that are kept. If more commands are sent within the dead time, neighbouring commands are merged
into their mean, which moves the robot equally far. Any two neighbouring slots span more than a quarter of the dead
time."""
_SHORTEST = 1e-9
"""[s] a shorter time is a rounding error"""
_MOTION_ERROR = 0.05
"""bound of the relative error of a commanded motion: +-5 % per wheel"""
_STRAIGHT = 0.01
"""[rad] below this angle sin(a) / a is computed from its series, which is exact to 1e-11 there"""


class HeldTwist(NamedTuple):
    """A command and the time for which it was held."""

    v: float
    """[m/s]"""
    omega: float
    """[rad/s]"""
    span: float
    """[s]"""


_NOTHING = HeldTwist(0.0, 0.0, 0.0)
CommandHistory = tuple[HeldTwist, HeldTwist, HeldTwist, HeldTwist, HeldTwist, HeldTwist, HeldTwist, HeldTwist]


class Actuation(NamedTuple):
    """Motion of the robot at the last pose, and the commands that may still act; the default is a robot at rest."""

    motion: Twist = Twist(0.0, 0.0)
    """velocities according to the model of the drives"""
    history: CommandHistory = (_NOTHING,) * SLOTS  # type: ignore[assignment]
    """the commands except the last one, oldest first"""


class Coasted(NamedTuple):
    """Prediction of the pose in which the robot would come to rest."""

    actuation: Actuation
    pose: Pose
    path_length: float
    """[m] distance driven until then; forward and backward motion both count as positive"""
    turned: float
    """[rad] angle turned until then; left and right turns both count as positive"""


def resting_actuation() -> Actuation:
    """Return the actuation at rest. All fields are given, because compiled code does not know the defaults."""
    none = HeldTwist(0.0, 0.0, 0.0)
    return Actuation(Twist(0.0, 0.0), (none, none, none, none, none, none, none, none))


def is_immediate(data_sheet: DataSheet) -> bool:
    """Return True if the robot has neither dead time nor lag."""
    return data_sheet.command_latency <= 0.0 and data_sheet.drive_time_constant <= 0.0


def _with_command(history: CommandHistory, command: Twist, dt: float, data_sheet: DataSheet) -> CommandHistory:
    """Add ``command``, which was held for the last ``dt`` [s]."""
    if dt <= 0.0:
        return history
    newest = history[SLOTS - 1]
    span = newest.span + dt
    if span > (data_sheet.command_latency + dt) * (2.0 / SLOTS):
        return (*history[1:], HeldTwist(command.v, command.omega, dt))
    share = dt / span
    joined = HeldTwist(
        newest.v + share * (command.v - newest.v), newest.omega + share * (command.omega - newest.omega), span
    )
    return (*history[:-1], joined)


def coast(pose: Pose, actuation: Actuation, command: Twist, dt: float, data_sheet: DataSheet) -> Coasted:
    """Predict where the robot comes to rest if zero is commanded from now on.

    Args:
        pose: current pose.
        actuation: actuation at the last pose.
        command: last command, which was held for the last ``dt``.
        dt: [s] since the last pose.
        data_sheet: dead time and time constant.
    """
    history = _with_command(actuation.history, command, dt, data_sheet)
    lag, latency = data_sheet.drive_time_constant, data_sheet.command_latency
    motion = actuation.motion if lag <= 0.0 else _motion_after(actuation.motion, history, dt, data_sheet)
    (v, omega), (x, y, theta) = motion, pose
    path_length = turned = 0.0
    first, skipped, _ = _command_at(history, latency)
    for index in range(first, SLOTS):
        held_v, held_omega, span = history[index]
        span, skipped = span - skipped, 0.0
        forward, turn = held_v * span, held_omega * span
        if lag > 0.0:
            left = math.exp(-span / lag)
            dv, domega, gone = v - held_v, omega - held_omega, lag * (1.0 - left)
            forward, turn = forward + dv * gone, turn + domega * gone
            v, omega = held_v + dv * left, held_omega + domega * left
        # The same as _moved, inlined because the loop runs at each pose.
        half = 0.5 * turn
        if half > _STRAIGHT or half < -_STRAIGHT:
            chord = forward * math.sin(half) / half
        else:
            chord = forward * (1.0 - half * half / 6.0)
        middle = theta + half
        x += chord * math.cos(middle)
        y += chord * math.sin(middle)
        theta += turn
        path_length, turned = path_length + abs(forward), turned + abs(turn)
    if lag > 0.0:
        x, y, theta = _moved(x, y, theta, v * lag, omega * lag)
        path_length, turned = path_length + abs(v) * lag, turned + abs(omega) * lag
    return Coasted(Actuation(motion, history), Pose(x, y, wrap_angle(theta)), path_length, turned)


def _command_at(history: CommandHistory, age: float) -> tuple[int, float, float]:
    """Return the index of the command that was held ``age`` [s] ago, and how long [s] it had been held by then.

    The third value is the part [s] of ``age`` before the first command of the history.
    """
    first, missing = SLOTS, age
    while missing > _SHORTEST and first > 0:
        first -= 1
        missing -= history[first].span
    return first, max(-missing, 0.0), max(missing, 0.0)


def after_a_period(actuation: Actuation, command: Twist, dt: float, data_sheet: DataSheet) -> Actuation:
    """Return the actuation ``dt`` [s] later, for a robot that brakes without its law; see :func:`coast`."""
    if dt <= 0.0 or is_immediate(data_sheet):
        return actuation
    return coast(Pose(0.0, 0.0, 0.0), actuation, command, dt, data_sheet).actuation


def _motion_after(motion: Twist, history: CommandHistory, dt: float, data_sheet: DataSheet) -> Twist:
    """Return the motion ``dt`` [s] after ``motion``; the robot was at rest before the first command."""
    lag = data_sheet.drive_time_constant
    index, skipped, missing = _command_at(history, data_sheet.command_latency + dt)
    v, omega = motion
    to_go = dt - missing
    while to_go > _SHORTEST and index < SLOTS:
        held = history[index]
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
    """Return the coasted pose as an estimate, whose uncertainty includes the predicted motion.

    The relative error of the predicted motion is assumed uniform in +-5 %.
    """
    path_length, turned = coasted.path_length, coasted.turned
    if path_length <= 0.0 and turned <= 0.0:
        return Estimate(coasted.pose, uncertainty)
    deviation = _MOTION_ERROR / math.sqrt(3.0)
    along, across = deviation * path_length, uncertainty.theta * path_length
    return Estimate(
        coasted.pose,
        Uncertainty(
            math.sqrt(uncertainty.xy * uncertainty.xy + along * along + across * across),
            math.hypot(uncertainty.theta, deviation * turned),
        ),
    )
