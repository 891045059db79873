"""Braking profiles: how fast the robot may still move at some distance from where it has to stop.

From the speed s(d; b, tau) the robot stops within d if it reacts after tau and then brakes with b:

    d = s tau + s^2 / (2 b)    so    s(d; b, tau) = 2 d / (tau + sqrt(tau^2 + 2 d / b))

Its slope at 0 is 1 / tau, a proportional gain; far away it is sqrt(2 b d), which needs the deceleration b and no more.
"""

from __future__ import annotations

import math
from typing import Annotated, NamedTuple

from diffbot_core.data_sheet import DataSheet
from diffbot_core.ranges import ACCELERATION, ANGULAR_ACCELERATION, GAIN
from diffbot_core.schema import Spec, known_fields

_BRAKE_SHARE = 0.86
"""share of the acceleration limit that a profile plans with; the rest is for errors of the estimate"""
_TURN_BRAKE_SHARE = 0.65
"""likewise for the rotation, which the drive's own turning disturbs"""
_UNKNOWN_LATENCY = 0.2
"""[s] dead time beyond the known one that automatic gains stay stable with"""
_UNKNOWN_SHARE = 0.1
"""share of the known latency and time constant that automatic gains take for not known"""
_DRIVE_LOOPS, _TURN_LOOPS, _HOLD_LOOPS = 2.0, 1.8, 1.6
"""reaction times in multiples of the loop's delay; 2 / pi would be the limit of stability"""


ARRIVAL_SHARE = 0.3
"""deviation of the position to arrive with, share of xy_goal_tolerance"""


@known_fields
class ProfileGains(NamedTuple):
    """Gains of the braking profiles; 1 / ``turn_react`` and 1 / ``hold_react`` are the paper's k and k_2 near 0."""

    brake: Annotated[
        float, Spec("deceleration that the speed is planned with, at most 0.86 of the limit", "m/s^2", *ACCELERATION)
    ] = 3.0
    react: Annotated[float, Spec("reaction time of the speed", "s", 0.01, 60.0)] = 0.5
    sigma_known: Annotated[
        float,
        Spec(
            "a position less certain than this, or than 0.3 of xy_goal_tolerance if that is more, is approached more "
            "slowly: react grows with the square",
            "m",
            1e-4,
            10.0,
        ),
    ] = 0.03
    bearing_weight: Annotated[float, Spec("weight of beta in Omega_G, the paper's h", "-", *GAIN)] = 0.8
    turn_brake: Annotated[
        float,
        Spec(
            "deceleration that turning to the goal is planned with, at most 0.65 of the limit",
            "rad/s^2",
            *ANGULAR_ACCELERATION,
        ),
    ] = 7.0
    turn_react: Annotated[float, Spec("reaction time of turning to the goal", "s", 0.01, 60.0)] = 0.45
    hold_brake: Annotated[
        float,
        Spec(
            "deceleration that turning in Omega_L is planned with, at most 0.65 of the limit",
            "rad/s^2",
            *ANGULAR_ACCELERATION,
        ),
    ] = 5.0
    hold_react: Annotated[float, Spec("reaction time of the heading in Omega_L", "s", 0.01, 60.0)] = 0.4


def braking(distance: float, brake: float, react: float) -> float:
    """Largest speed s with s^2 / (2 brake) + s react <= ``distance`` >= 0; any unit of length, also rad."""
    return 2.0 * distance / (react + math.sqrt(react * react + 2.0 * distance / brake))


def signed_braking(error: float, brake: float, react: float, largest: float) -> float:
    """Return phi(a) = sign(a) min(largest, s(|a|)): odd, and phi(a) a >= 0."""
    return math.copysign(min(largest, braking(abs(error), brake, react)), error)


def approach_speed(rho: float, vagueness: float, gains: ProfileGains, v_max: float) -> float:
    """Return f(rho) [m/s] >= 0, f(0) = 0: slower with a ``vagueness`` above 1, see :func:`vagueness_of`."""
    react = gains.react * vagueness * vagueness if vagueness > 1.0 else gains.react
    return min(v_max, braking(rho, gains.brake, react))


def vagueness_of(sigma_xy: float, gains: ProfileGains, xy_goal_tolerance: float) -> float:
    """Return the deviation of the position in units of the one to arrive with: a wide tolerance needs less."""
    return sigma_xy / max(gains.sigma_known, ARRIVAL_SHARE * xy_goal_tolerance)


def within_data_sheet(gains: ProfileGains, data_sheet: DataSheet) -> ProfileGains:
    """Return the gains with decelerations that the robot is capable of."""
    if data_sheet.a_max == math.inf and data_sheet.omega_dot_max == math.inf:
        return gains
    turning = _TURN_BRAKE_SHARE * data_sheet.omega_dot_max
    # Compiled code has no _replace.
    return ProfileGains(
        brake=min(gains.brake, _BRAKE_SHARE * data_sheet.a_max),
        react=gains.react,
        sigma_known=gains.sigma_known,
        bearing_weight=gains.bearing_weight,
        turn_brake=min(gains.turn_brake, turning),
        turn_react=gains.turn_react,
        hold_brake=min(gains.hold_brake, turning),
        hold_react=gains.hold_react,
    )


def auto_gains(data_sheet: DataSheet, period: float) -> ProfileGains:
    """Derive the gains from sampling period [s], latency and limits, as ``gains: auto`` does.

    The loop reacts after half a period, the command being held, and after the dead time that the prediction does not
    remove: 0.2 s that the data sheet may not tell, and a tenth of what it does. With 0.1 s and an ideal robot these are
    the default gains.
    """
    known = data_sheet.command_latency + data_sheet.drive_time_constant
    loop = 0.5 * period + _UNKNOWN_LATENCY + _UNKNOWN_SHARE * known
    # Compiled code has neither _replace nor defaults.
    gains = ProfileGains(
        brake=3.0,
        react=_DRIVE_LOOPS * loop,
        sigma_known=0.03,
        bearing_weight=0.8,
        turn_brake=7.0,
        turn_react=_TURN_LOOPS * loop,
        hold_brake=5.0,
        hold_react=_HOLD_LOOPS * loop,
    )
    return within_data_sheet(gains, data_sheet)
