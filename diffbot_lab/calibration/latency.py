"""Dead time from a velocity command to the motion, by least squares of commanded and measured velocity."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from scipy.signal import lfilter

from diffbot_lab.calibration.events import Array, Odometry

_STEP = 0.01
"""[s] of the grid in time, and of the dead times tried"""
MAX_LATENCY = 1.0
"""[s]"""
LAGS = (0.0, 0.02, 0.05, 0.1, 0.15, 0.2, 0.3, 0.4, 0.6)
"""[s] time constants tried"""
_MIN_COMMANDS = 20


class Latency(NamedTuple):
    """Answer of the robot to its commands."""

    dead_time: float
    """[s]"""
    sigma: float
    """[s] its standard deviation, errors of a second taken as one"""
    time_constant: float
    """[s] of the drives"""


def latency_of(commands: Array, odometry: Odometry, odometry_delay: float) -> Latency | None:
    """Find dead time and time constant.

    Args:
        commands: (n, 3) time [s], v [m/s] and omega [rad/s] of each command; held until the next.
        odometry: measured twists.
        odometry_delay: [s] by which the motion follows the odometry's stamps.

    Returns:
        None if there are too few commands, or they do not change.
    """
    if len(commands) < _MIN_COMMANDS:
        return None
    first, last = max(commands[0, 0], odometry.start[0] + odometry_delay), odometry.end[-1] + odometry_delay
    grid = np.arange(first, last, _STEP)
    if len(grid) * _STEP < 5.0:
        return None
    index = np.clip(np.searchsorted(odometry.end + odometry_delay, grid), 0, len(odometry.end) - 1)
    measured = odometry.twist[index]
    held = commands[np.clip(np.searchsorted(commands[:, 0], grid, side="right") - 1, 0, None), 1:]
    spread = held.std(axis=0)
    if not (spread > 1e-6).any():
        return None
    use = spread > 1e-6
    scale = np.where(measured.std(axis=0) > 1e-9, measured.std(axis=0), 1.0)
    shifts = round(MAX_LATENCY / _STEP)

    def costs_of(lag: float) -> Array:
        answer = _filtered(held, lag)
        return np.array(
            [_cost(answer[: len(grid) - shift], measured[shift:], scale, use) for shift in range(shifts + 1)]
        )

    lag, costs = min(((lag, costs_of(lag)) for lag in LAGS), key=lambda found: float(found[1].min()))
    at = int(costs.argmin())
    return Latency(at * _STEP, _sigma(costs, at, len(grid) * _STEP), lag)


def _filtered(held: Array, lag: float) -> Array:
    if lag == 0.0:
        return held
    keep = math.exp(-_STEP / lag)
    filtered: Array = lfilter([1.0 - keep], [1.0, -keep], held, axis=0, zi=keep * held[:1])[0]
    return filtered


def _cost(answer: Array, measured: Array, scale: Array, use: Array) -> float:
    """Return the mean squared difference after the best gain of each velocity: a wheel error is no dead time."""
    total = 0.0
    for column in np.flatnonzero(use):
        a, b = answer[:, column], measured[:, column] / scale[column]
        gain = float(a @ b) / max(float(a @ a), 1e-12)
        total += float(np.mean((b - gain * a) ** 2))
    return total


def _sigma(costs: Array, at: int, seconds: float) -> float:
    if not 0 < at < len(costs) - 1:
        return math.nan
    curvature = float(costs[at - 1] - 2.0 * costs[at] + costs[at + 1]) / (_STEP * _STEP)
    # Second derivative of n / (2 variance) times the mean square, with an independent error each second.
    return math.sqrt(2.0 * max(float(costs[at]), 1e-12) / (max(curvature, 1e-12) * seconds)) + _STEP / math.sqrt(12.0)
