"""From the requested twist to the wheels: dead time, limits, lag, stiction and slip. Pure functions of floats.

A command passes these stages in this order; each is off by default and then changes no bit:

1. dead time of the link and the base driver (:func:`delayed_command`),
2. the base driver's acceleration limiter, each axis of the twist by itself and once a sampling time,
3. saturation of the wheels, which keeps the curvature, and the motors' acceleration,
4. a first-order lag of each wheel, tau dw/dt = u - w, solved exactly for a target u that is constant over the step,
5. a dead band with stiction: a wheel that stands starts at ``breakaway``, one that turns stops below ``dead_band``.

A wheel loses part of its motion on the ground (:func:`lost_shares`), which its encoder does not measure.
"""

from __future__ import annotations

import math
from typing import Annotated, Any, NamedTuple

from diffbot_core.kinematics import Twist, WheelGeometry, WheelSpeeds, wheel_speeds
from diffbot_core.ranges import ACCELERATION, ANGULAR_ACCELERATION, WHEEL_ACCELERATION, WHEEL_SPEED
from diffbot_core.schema import Spec, known_fields
from diffbot_sim.model.philox import Draw, direction, probability

_INF = math.inf
MAX_COMMAND_DELAY = 5.0
"""[s]"""


@known_fields
class ActuatorConfig(NamedTuple):
    """What lies between a command and the motion; by default the wheels follow at once."""

    command_delay: Annotated[float, Spec("dead time of the commands", "s", minimum=0.0, maximum=MAX_COMMAND_DELAY)] = (
        0.0
    )
    drive_time_constant: Annotated[
        float, Spec("time constant of the drives' first-order lag; 0: none", "s", minimum=0.0, maximum=10.0)
    ] = 0.0
    acceleration_max: Annotated[
        float,
        Spec("bound of |dv/dt| in the base driver", "m/s^2", *ACCELERATION, allow_inf=True),
    ] = _INF
    angular_acceleration_max: Annotated[
        float,
        Spec("bound of |domega/dt| in the base driver", "rad/s^2", *ANGULAR_ACCELERATION, allow_inf=True),
    ] = _INF
    wheel_speed_max: Annotated[
        float,
        Spec("bound of each wheel's |speed|", "rad/s", *WHEEL_SPEED, allow_inf=True),
    ] = _INF
    wheel_acceleration_max: Annotated[
        float,
        Spec("bound of each wheel's |acceleration|", "rad/s^2", *WHEEL_ACCELERATION, allow_inf=True),
    ] = _INF
    dead_band: Annotated[
        float, Spec("|speed| below which a turning wheel stops", "rad/s", minimum=0.0, maximum=1000.0)
    ] = 0.0
    breakaway: Annotated[
        float,
        Spec("|speed| from which a standing wheel starts, at least dead_band", "rad/s", minimum=0.0, maximum=1000.0),
    ] = 0.0
    slip_noise: Annotated[
        float,
        Spec(
            "scale of the half-normal share of a wheel's motion lost in each step; the mean is 0.8 of it",
            minimum=0.0,
            maximum=1.0,
        ),
    ] = 0.0
    separation_error: Annotated[
        float, Spec("relative error of the distance of the wheels", minimum=-0.5, maximum=0.5)
    ] = 0.0


class ActuatorState(NamedTuple):
    """What the actuators remember of the last step."""

    limited: Twist = Twist(0.0, 0.0)
    """command after the base driver's acceleration limiter"""
    drive: WheelSpeeds = WheelSpeeds(0.0, 0.0)
    """[rad/s] speeds that the drives aimed at"""
    lagged: WheelSpeeds = WheelSpeeds(0.0, 0.0)
    """[rad/s] speeds that the drives had reached at the end of the step, without stiction"""
    turning: WheelSpeeds = WheelSpeeds(0.0, 0.0)
    """[rad/s] mean speeds over the step with stiction; 0 means that the wheel stands"""


class LostShares(NamedTuple):
    """Share of each wheel's motion lost in a step, 0 .. 1."""

    left: float
    right: float


NO_LOSS = LostShares(0.0, 0.0)


def new_actuators() -> ActuatorState:
    """Return the state at rest."""
    rest = WheelSpeeds(0.0, 0.0)
    return ActuatorState(Twist(0.0, 0.0), rest, rest, rest)


def command_rows(delay: float, sampling_time: float) -> int:
    """Return how many commands :func:`delayed_command` needs to remember; 0 without a delay [s]."""
    return math.ceil(delay / sampling_time) + 2 if delay > 0.0 else 0


def delayed_command(record: Any, step: int, command: Twist, delay: float, sampling_time: float) -> Twist:
    """Remember a command and return the mean one that is in force over this step, ``delay`` [s] late.

    If the delay is no whole number of steps, the step begins under the older of two commands: they are mixed by their
    shares of the step. Before step 0 the command is zero.

    Args:
        record: (n, 2) ring of the newest commands, zero at first; n = 0 or at least :func:`command_rows`.
        step: number of the present step.
        command: requested in it.
        delay: dead time [s].
        sampling_time: [s].
    """
    rows = len(record)
    if rows == 0:
        return command
    record[step % rows, 0], record[step % rows, 1] = command.v, command.omega
    late = delay / sampling_time
    # With a margin for rounding: 0.3 s are three steps of 0.1 s.
    whole = math.floor(late + 1e-9)
    newer = (step - whole) % rows
    share = late - whole
    if share < 1e-9:
        return Twist(float(record[newer, 0]), float(record[newer, 1]))
    older = (step - whole - 1) % rows
    return Twist(
        float(share * record[older, 0] + (1.0 - share) * record[newer, 0]),
        float(share * record[older, 1] + (1.0 - share) * record[newer, 1]),
    )


def actuate(
    state: ActuatorState, command: Twist, wheels: WheelGeometry, sampling_time: float, config: ActuatorConfig
) -> ActuatorState:
    """Turn the wheels for one sampling time [s] under a command that has arrived at the base driver."""
    limited = Twist(
        _towards(state.limited.v, command.v, config.acceleration_max * sampling_time),
        _towards(state.limited.omega, command.omega, config.angular_acceleration_max * sampling_time),
    )
    drive = _drive(state.drive, wheel_speeds(limited, wheels), sampling_time, config)
    lagged, mean = drive, drive
    if config.drive_time_constant > 0.0:
        ratio = sampling_time / config.drive_time_constant
        left, right = state.lagged.left - drive.left, state.lagged.right - drive.right
        # What is left of the difference at the end of the step, and its mean over the step.
        end, share = math.exp(-ratio), -math.expm1(-ratio) / ratio
        lagged = WheelSpeeds(drive.left + left * end, drive.right + right * end)
        mean = WheelSpeeds(drive.left + left * share, drive.right + right * share)
    turning = WheelSpeeds(
        _with_stiction(mean.left, state.turning.left, config), _with_stiction(mean.right, state.turning.right, config)
    )
    return ActuatorState(limited, drive, lagged, turning)


def lost_shares(noise: Draw, scale: float) -> LostShares:
    """Return half-normal shares |N(0, scale)|, at most 1, independent for both wheels; ``noise`` is (., ., -, -).

    Box and Muller's transform, "A note on the generation of random normal deviates", Ann. Math. Stat. 29 (1958).
    """
    radius = scale * math.sqrt(-2.0 * math.log(probability(noise.a)))
    angle = direction(noise.b)
    return LostShares(min(radius * abs(math.cos(angle)), 1.0), min(radius * abs(math.sin(angle)), 1.0))


def _towards(before: float, requested: float, change: float) -> float:
    """Return ``requested``, but at most ``change`` away from ``before``."""
    return min(max(requested, before - change), before + change)


def _drive(before: WheelSpeeds, requested: WheelSpeeds, sampling_time: float, config: ActuatorConfig) -> WheelSpeeds:
    """Return the target speeds of the drives: scaled together to the speed limit, then limited in acceleration."""
    fastest = max(abs(requested.left), abs(requested.right))
    scale = config.wheel_speed_max / fastest if fastest > config.wheel_speed_max else 1.0
    change = config.wheel_acceleration_max * sampling_time
    return WheelSpeeds(
        _towards(before.left, requested.left * scale, change), _towards(before.right, requested.right * scale, change)
    )


def _with_stiction(speed: float, before: float, config: ActuatorConfig) -> float:
    """Return the speed [rad/s] of a wheel that turned at ``before``, when its drive turns at ``speed``."""
    threshold = max(config.breakaway, config.dead_band) if before == 0.0 else config.dead_band
    return 0.0 if abs(speed) < threshold else speed
