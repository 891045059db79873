"""Whether the sampled loop is stable: gains, sampling time, latency, lag and acceleration limits together."""

from __future__ import annotations

import math

from diffbot_control.law.configuration import AUTO, TANH, ControllerConfig
from diffbot_control.law.lyapunov_law import Gains, sampled_poles
from diffbot_control.law.speed_profile import auto_gains, within_data_sheet
from diffbot_core.data_sheet import DataSheet

_OVERSHOOT = 1.0
"""[rad] that a turn from the opposite heading may overshoot by"""
_STEEPEST = 2.0 / (3.0 * math.sqrt(3.0))
"""largest tanh(r) (1 - tanh(r)^2)"""


def largest_gain(delay: int) -> float:
    """Return the bound of g for which x(n+1) = x(n) - g x(n - delay) is stable: 2 sin(pi / (2 (2 delay + 1)))."""
    return 2.0 * math.sin(0.5 * math.pi / (2.0 * delay + 1.0))


def unstable_gains(config: ControllerConfig, t_s: float) -> str:
    """Return a one-line warning if the loop cannot be stable with ``t_s`` [s] per step; empty if nothing is found."""
    if config.profile == TANH:
        parts = [*_unstable_poles(config.gains, t_s), *_delayed(config, t_s), *_braking_needed(config)]
    else:
        parts = _steep_profiles(config, t_s)
    if not parts:
        return ""
    return f"gains are not stable at {t_s:.3g} s per step, {'; '.join(parts)}"


def _unstable_poles(gains: Gains, t_s: float) -> list[str]:
    """Eigenvalues of the loop without delay."""
    angles, distance, heading = sampled_poles(gains, t_s)
    parts = (
        ("k, h and gamma (angles in Omega_G)", angles),
        ("gamma (distance)", distance),
        ("k_2 (heading in Omega_L)", heading),
    )
    found = [f"{name}: {size:.2f}" for name, size in parts if size >= 1.0]
    return [f"eigenvalues must be inside the unit circle: {', '.join(found)}"] if found else []


def _steps_late(data_sheet: DataSheet, t_s: float) -> int:
    """Steps by which the motion follows the command; a lag counts as so much dead time."""
    late = data_sheet.command_latency + data_sheet.drive_time_constant
    return math.ceil(late / t_s - 1e-9) if t_s > 0.0 else 0


def _delayed(config: ControllerConfig, t_s: float) -> list[str]:
    """Gains of the paper's law, which does not predict, that are too large for the delay."""
    delay = _steps_late(config.data_sheet, t_s)
    if delay == 0:
        return []
    gains, bound = config.gains, largest_gain(delay)
    parts = (
        ("k + gamma (angles in Omega_G)", (gains.k + gains.gamma) * t_s),
        ("gamma (distance)", gains.gamma * t_s),
        ("k_2 (heading in Omega_L)", gains.k_2 * t_s),
    )
    return [
        f"{name}: {gain:.2f} per step, must be below {bound:.2f} with {delay} steps of latency and lag"
        for name, gain in parts
        if gain >= bound
    ]


def _braking_needed(config: ControllerConfig) -> list[str]:
    """Gains of the paper's law, which does not brake by itself, that ask for more than the limits of acceleration.

    A turn by pi that accelerates with a meets omega = k e at the error e with k^2 e^2 = 2 a (pi - e); braking with a
    from there takes as long a way as accelerating did.
    """
    gains, data_sheet = config.gains, config.data_sheet
    found = []
    for name, gain in (("k", gains.k), ("k_2", gains.k_2)):
        a = data_sheet.omega_dot_max
        if a < math.inf:
            square = gain * gain
            error = (math.sqrt(a * a + 2.0 * math.pi * a * square) - a) / square
            overshoot = math.pi - 2.0 * error
            if overshoot > _OVERSHOOT:
                found.append(
                    f"{name}: with angular.z.max_acceleration {a:g} a half turn overshoots by {overshoot:.1f} rad"
                )
    needed = _STEEPEST * gains.gamma * gains.gamma
    if needed > data_sheet.a_max:
        found.append(f"gamma: braking takes {needed:.2f} m/s^2, linear.x.max_acceleration is {data_sheet.a_max:g}")
    return found


def _steep_profiles(config: ControllerConfig, t_s: float) -> list[str]:
    """Slopes of the braking profiles that are too large for the sampling time; known latency and lag are predicted."""
    if config.gain_source == AUTO:
        gains = auto_gains(config.data_sheet, t_s)
    else:
        gains = within_data_sheet(config.profile_gains, config.data_sheet)
    parts = (
        ("turn_react and react (angles in Omega_G)", t_s / gains.turn_react + t_s / gains.react),
        ("react (distance)", t_s / gains.react),
        ("hold_react (heading in Omega_L)", t_s / gains.hold_react),
    )
    bound = largest_gain(0)
    return [f"{name}: {gain:.2f} per step, must be below {bound:.2f}" for name, gain in parts if gain >= bound]
