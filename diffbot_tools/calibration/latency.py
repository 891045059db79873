"""Dead time from a velocity command to the motion, by least squares of commanded and measured velocity.

What lies between is tried as the plant of a base has it: a dead time, the base driver's limit of the acceleration, a
first-order lag. A limit that is left out is taken for dead time: a ramp that lasts a second is late by half of it.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numba
import numpy as np
from scipy.optimize import minimize

from diffbot_tools.calibration.events import Array, Odometry

_STEP = 0.02
"""[s] between the dead times tried first"""
MAX_LATENCY = 1.0
"""[s]"""
LAGS = (0.0, 0.02, 0.05, 0.1, 0.15, 0.2, 0.3, 0.4, 0.6)
"""[s] time constants tried first"""
LIMITS = (math.inf, *(float(limit) for limit in 0.1 * 1.25 ** np.arange(20)))
"""[m/s^2], [rad/s^2] limits of acceleration tried first"""
_STARTS = 3
"""of the values tried first, the best ones from which the least squares begin"""
_GAIN, _MIN_GAIN = 0.02, 5e-3
"""A limit is taken for real if it explains this share of the cost without it, and of the variance of the velocity."""
_MIN_COMMANDS, _MIN_SECONDS = 20, 5.0


class Latency(NamedTuple):
    """Answer of the robot to its commands."""

    dead_time: float
    """[s]"""
    sigma: float
    """[s] its standard deviation, errors of a second taken as one"""
    time_constant: float
    """[s] of the drives"""
    acceleration: float
    """[m/s^2] the base driver's limit; inf if there is none to see"""
    angular_acceleration: float
    """[rad/s^2] the same of the rotation"""


def limits_of(latency: Latency) -> dict[str, float]:
    """Return the limits of acceleration that were found, by the names of the controller's parameters."""
    names = ("linear.x.max_acceleration", "angular.z.max_acceleration")
    limits = (latency.acceleration, latency.angular_acceleration)
    return {name: limit for name, limit in zip(names, limits, strict=True) if limit < math.inf}


class _Drive(NamedTuple):
    """What is compared: the odometry's intervals in which commands were known."""

    commands: Array
    start: Array
    """(n,) [s]"""
    end: Array
    """(n,) [s]"""
    measured: Array
    """(n, 2) in deviations of each velocity"""
    axes: list[int]
    """velocities that were commanded"""


def latency_of(commands: Array, odometry: Odometry, odometry_delay: float) -> Latency | None:
    """Find dead time, time constant and limits of acceleration.

    Args:
        commands: (n, 3) time [s], v [m/s] and omega [rad/s] of each command; held until the next.
        odometry: measured twists.
        odometry_delay: [s] by which the motion follows the odometry's stamps.

    Returns:
        None if there are too few commands, or they do not change.
    """
    if len(commands) < _MIN_COMMANDS:
        return None
    start, end = odometry.start + odometry_delay, odometry.end + odometry_delay
    use = (start >= commands[0, 0]) & (end > start)
    if float((end - start)[use].sum()) < _MIN_SECONDS:
        return None
    spread = odometry.twist[use].std(axis=0)
    measured = odometry.twist[use] / np.where(spread > 1e-9, spread, 1.0)
    axes = [axis for axis in (0, 1) if commands[:, 1 + axis].std() > 1e-6]
    if not axes:
        return None
    drive = _Drive(commands, start[use], end[use], measured, axes)
    return min((_refined(drive, *one) for one in _starts(drive)), key=lambda found: found[0])[1]


def _starts(drive: _Drive) -> list[tuple[float, float, dict[int, float]]]:
    """Return dead time, time constant and limits of each axis of the best grid points with different time constants."""
    shifts = np.arange(0.0, MAX_LATENCY + 0.5 * _STEP, _STEP)
    commanded = np.stack([_mean_command(drive.commands, drive.start - one, drive.end - one) for one in shifts])
    period = drive.end - drive.start
    costs = {
        axis: _all_costs(
            commanded[:, :, axis].copy(), drive.measured[:, axis].copy(), period, np.array(LAGS), np.array(LIMITS)
        )
        for axis in drive.axes
    }
    total = np.sum([one.min(axis=1) for one in costs.values()], axis=0)
    found = []
    for lag in np.argsort(total.min(axis=1))[:_STARTS]:
        at = int(total[lag].argmin())
        bounds = {axis: _limit(one[lag, :, at]) for axis, one in costs.items()}
        found.append((float(shifts[at]), LAGS[lag], bounds))
    return found


def _limit(costs: Array) -> float:
    """Return the best of LIMITS, inf if it explains hardly more than none does."""
    best = int(costs.argmin())
    return LIMITS[best] if costs[0] - costs[best] > max(_GAIN * costs[0], _MIN_GAIN) else math.inf


def _refined(drive: _Drive, dead_time: float, lag: float, limits: dict[int, float]) -> tuple[float, Latency]:
    """Return the cost and the result of least squares that begin there."""
    limited = [axis for axis in drive.axes if limits[axis] < math.inf]
    period = drive.end - drive.start

    def values_of(x: Array) -> tuple[float, float, dict[int, float]]:
        found = {axis: math.exp(value) for axis, value in zip(limited, x[2:], strict=False)}
        return float(x[0]), float(x[1]), {axis: found.get(axis, math.inf) for axis in drive.axes}

    def residuals(x: Array) -> Array:
        dead, tau, bounds = values_of(x)
        tau = max(tau, 0.0)
        mean = _mean_command(drive.commands, drive.start - dead, drive.end - dead)
        parts = []
        for axis in drive.axes:
            answer = _answer(mean[:, axis].copy(), period, tau, bounds[axis])
            gain = float(answer @ drive.measured[:, axis]) / max(float(answer @ answer), 1e-12)
            parts.append(drive.measured[:, axis] - gain * answer)
        return np.concatenate(parts)

    def cost(x: Array) -> float:
        return float(np.sum(residuals(x) ** 2))

    # Without derivatives: held commands make the residuals jump.
    steps = np.array([_STEP, _STEP, *(0.05 for _ in limited)])
    first = np.array([dead_time, lag, *(math.log(limits[axis]) for axis in limited)])
    bounds = [(0.0, MAX_LATENCY), (0.0, 2.0 * LAGS[-1]), *((None, None) for _ in limited)]
    simplex = np.vstack([first, first + np.diag(steps)])
    options = {"initial_simplex": simplex, "xatol": 1e-3, "fatol": 1e-9 * cost(first)}
    x = minimize(cost, first, method="Nelder-Mead", bounds=bounds, options=options).x
    dead, tau, accelerations = values_of(x)
    sigma = math.hypot(
        _sigma(residuals, x, steps, float(period.sum()) * len(drive.axes)),
        # A base acts once a period: within it the dead time hardly shows.
        float(period.mean()) / math.sqrt(12.0),
    )
    return cost(x), Latency(dead, sigma, tau, accelerations.get(0, math.inf), accelerations.get(1, math.inf))


def _sigma(residuals: Callable[[Array], Array], x: Array, steps: Array, seconds: float) -> float:
    """Return the deviation [s] of the dead time, with as many independent errors as seconds."""
    errors = residuals(x)
    columns = []
    for row in np.diag(steps):
        # The flatter side: behind a limiter a dead time shows only where it changes the driver's period.
        sides = [(residuals(one) - errors) / row.sum() for one in (x + row, x - row)]
        columns.append(min(sides, key=np.linalg.norm))
    jacobian = np.column_stack(columns)
    variance = np.linalg.pinv(jacobian.T @ jacobian)[0, 0] * float(errors @ errors) / seconds
    return math.sqrt(variance)


def _mean_command(commands: Array, start: Array, end: Array) -> Array:
    """Return the mean (n, 2) of the held commands over each interval [s]; zero before the first."""
    times = commands[:, 0]
    way = np.zeros((len(commands), 2))
    way[1:] = np.cumsum(commands[:-1, 1:] * np.diff(times)[:, np.newaxis], axis=0)

    def way_at(moment: Array) -> Array:
        index = np.searchsorted(times, moment, side="right") - 1
        known = np.clip(index, 0, None)
        ways: Array = way[known] + commands[known, 1:] * (moment - times[known])[:, np.newaxis]
        return np.where(index[:, np.newaxis] < 0, 0.0, ways)

    mean: Array = (way_at(end) - way_at(start)) / (end - start)[:, np.newaxis]
    return mean


@numba.njit(cache=True)
def _answer(commanded: Any, period: Any, lag: Any, limit: Any) -> Any:
    """Return the mean speeds of an axis behind a limit of acceleration and a lag, in the plant's order."""
    answers = np.empty(len(commanded))
    speed = reached = commanded[0]
    for k in range(len(commanded)):
        change = limit * period[k]
        speed += min(max(commanded[k] - speed, -change), change)
        answers[k] = speed
        if lag > 0.0:
            # Mean and end of an exponential approach to the speed.
            left = math.exp(-period[k] / lag)
            answers[k] = speed + (reached - speed) * (1.0 - left) * lag / period[k]
            reached = speed + (reached - speed) * left
    return answers


@numba.njit(cache=True)
def _all_costs(commanded: Any, measured: Any, period: Any, lags: Any, limits: Any) -> Any:
    """Return the mean squared differences (lags, limits, shifts) after the best gain: a wheel error is no dead time."""
    shifts, n = commanded.shape
    costs = np.empty((len(lags), len(limits), shifts))
    square = np.dot(measured, measured)
    for i in range(len(lags)):
        for j in range(len(limits)):
            for shift in range(shifts):
                answer = _answer(commanded[shift], period, lags[i], limits[j])
                both = np.dot(answer, measured)
                costs[i, j, shift] = (square - both * both / max(np.dot(answer, answer), 1e-12)) / n
    return costs
