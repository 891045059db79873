"""Estimate the dead time from a velocity command to the motion by least squares of commanded and measured velocities.

The model equals the simulated base: a dead time, the acceleration limit of the base driver, and a first-order
lag. Without the acceleration limit, a ramp of one second would add half a second of dead time.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import OptimizeResult, least_squares

from diffbot_tools.calibration.events import Array, Odometry
from diffbot_tools.calibration.kernel import compiled

MAX_LATENCY, _MAX_LAG = 1.0, 1.2
"""[s] largest dead time and time constant"""
_DEAD_TIMES, _LAG, _LIMITS = (0.05, 0.2, 0.5), 0.1, (0.3, 1.0, 3.0)
"""Start values of the least squares: dead times [s], time constant [s], acceleration limits [m/s^2, rad/s^2]."""
_MIN_LIMIT, _MAX_LIMIT = 0.05, 20.0
"""[m/s^2], [rad/s^2] smallest and largest acceleration limit of the search"""
_STEP, _LOG_STEP = 0.02, 0.05
"""Steps of the derivatives: [s] for times, and for logarithms."""
_NO_LAG = 1e-3
"""[s] time constant that counts as 0"""
_GAIN, _MIN_GAIN = 0.02, 5e-3
"""An acceleration limit is accepted if it explains these shares of the cost and of the variance of a velocity."""
_MIN_COMMANDS, _MIN_SECONDS = 20, 5.0
"""Fewest commands and shortest odometry [s] for an estimate."""


class LatencyEstimate(NamedTuple):
    """Estimated response of the robot to velocity commands."""

    dead_time: float
    """[s]"""
    sigma: float
    """[s] standard deviation of the dead time, assuming one independent error per second"""
    time_constant: float
    """[s] of the first-order lag of the drives"""
    acceleration: float
    """[m/s^2] limit of the base driver; inf if no limit was found"""
    angular_acceleration: float
    """[rad/s^2] limit of the base driver; inf if no limit was found"""

    def limits(self) -> dict[str, float]:
        """Return the acceleration limits that were found, by the names of the parameters of the controller."""
        names = ("linear.x.max_acceleration", "angular.z.max_acceleration")
        limits = (self.acceleration, self.angular_acceleration)
        return {name: limit for name, limit in zip(names, limits, strict=True) if limit < math.inf}


class _Drive(NamedTuple):
    """The odometry since the first command."""

    commands: Array
    """(c, 3) time [s], v [m/s], omega [rad/s]"""
    start: Array
    """(n,) [s]"""
    end: Array
    """(n,) [s]"""
    measured: Array
    """(n, 2) twist, each velocity divided by its standard deviation"""
    axes: list[int]
    """indices of the velocities whose commands change"""


def latency_of(commands: Array, odometry: Odometry, odometry_delay: float) -> LatencyEstimate | None:
    """Estimate dead time, time constant and acceleration limits.

    Args:
        commands: (n, 3) time [s], v [m/s] and omega [rad/s] of each command, which is held until the next.
        odometry: measured twists.
        odometry_delay: time [s] by which the motion is later than the stamps of the odometry.

    Returns:
        None if there are too few commands, too little odometry, or the commands do not change.
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
    every, limited = tuple(axes), list[int]()
    all_limited = _fit(drive, every)
    for axis in axes:
        without = _fit(drive, tuple(one for one in every if one != axis))
        if without.cost - all_limited.cost > max(_GAIN * without.cost, 0.5 * _MIN_GAIN * len(drive.start)):
            limited.append(axis)
    found = all_limited if len(limited) == len(axes) else _fit(drive, tuple(limited))
    period = drive.end - drive.start
    # A lag at its bound of 0 is known, so it does not add to the uncertainty of the dead time.
    jacobian = found.jac if found.x[1] > _NO_LAG else np.delete(found.jac, 1, axis=1)
    independent = float(period.sum()) * len(axes)  # one error per second
    variance = np.linalg.pinv(jacobian.T @ jacobian)[0, 0] * 2.0 * found.cost / independent
    # A base executes commands once per period, so the period limits the resolution of the dead time.
    sigma = math.hypot(math.sqrt(variance), float(period.mean()) / math.sqrt(12.0))
    return LatencyEstimate(float(found.x[0]), sigma, float(found.x[1]), *_limits_of(limited, found.x))


def _fit(drive: _Drive, limited: tuple[int, ...]) -> OptimizeResult:
    """Return the best of the minima that least squares find from several starts.

    The result's ``x`` is dead time [s], time constant [s] and the logarithm of the limit of each axis in ``limited``.
    """
    low = [0.0, 0.0, *(math.log(_MIN_LIMIT) for _ in limited)]
    high = [MAX_LATENCY, _MAX_LAG, *(math.log(_MAX_LIMIT) for _ in limited)]
    return min(
        (
            least_squares(
                lambda x: _residuals(drive, limited, x),
                [dead, _LAG, *(math.log(limit) for _ in limited)],
                jac=lambda x: _derivatives(drive, limited, x),
                bounds=(low, high),
                xtol=1e-4,
            )
            for dead in _DEAD_TIMES
            for limit in (_LIMITS if limited else (math.inf,))
        ),
        key=lambda found: found.cost,
    )


def _derivatives(drive: _Drive, limited: tuple[int, ...], x: Array) -> Array:
    """Return the derivatives (residuals, len(x)) by central differences. Wide steps smooth kinks at new commands."""
    steps = np.diag([_STEP, _STEP, *(_LOG_STEP for _ in limited)])
    ends = [(_residuals(drive, limited, x + one), _residuals(drive, limited, x - one)) for one in steps]
    derivatives: Array = np.column_stack([ahead - behind for ahead, behind in ends]) / (2.0 * steps.sum(axis=0))
    return derivatives


def _limits_of(limited: Sequence[int], x: Array) -> tuple[float, float]:
    """Return the acceleration limit of each axis; inf for an axis without a limit."""
    found = dict(zip(limited, np.exp(x[2:]).tolist(), strict=True))
    return found.get(0, math.inf), found.get(1, math.inf)


def _residuals(drive: _Drive, limited: tuple[int, ...], x: Array) -> Array:
    """Return measured minus modelled velocities.

    Each modelled velocity has the best gain, so that errors of the wheels do not change the dead time.
    """
    dead, lag, limits = float(x[0]), max(float(x[1]), 0.0), _limits_of(limited, x)
    mean = _mean_command(drive.commands, drive.start - dead, drive.end - dead)
    parts = []
    for axis in drive.axes:
        response = compiled(_response)(mean[:, axis].copy(), drive.end - drive.start, lag, limits[axis])
        gain = float(response @ drive.measured[:, axis]) / max(float(response @ response), 1e-12)
        parts.append(drive.measured[:, axis] - gain * response)
    return np.concatenate(parts)


def _mean_command(commands: Array, start: Array, end: Array) -> Array:
    """Return the mean (n, 2) of the held commands over each interval [s]. Before the first command, it is zero."""
    times = commands[:, 0]
    distance = np.zeros((len(commands), 2))
    distance[1:] = np.cumsum(commands[:-1, 1:] * np.diff(times)[:, np.newaxis], axis=0)

    def distance_at(moment: Array) -> Array:
        index = np.searchsorted(times, moment, side="right") - 1
        known = np.clip(index, 0, None)
        reached: Array = distance[known] + commands[known, 1:] * (moment - times[known])[:, np.newaxis]
        return np.where(index[:, np.newaxis] < 0, 0.0, reached)

    mean: Array = (distance_at(end) - distance_at(start)) / (end - start)[:, np.newaxis]
    return mean


def _response(commanded: Any, period: Any, lag: Any, limit: Any) -> Any:
    """Return the mean speeds of an axis after the acceleration limit and then the lag, the order of the plant."""
    responses = np.empty(len(commanded))
    speed = reached = commanded[0]
    for k in range(len(commanded)):
        change = limit * period[k]
        speed += min(max(commanded[k] - speed, -change), change)
        responses[k] = speed
        if lag > 0.0:
            # Mean and end of an exponential approach to the speed.
            left = math.exp(-period[k] / lag)
            responses[k] = speed + (reached - speed) * (1.0 - left) * lag / period[k]
            reached = speed + (reached - speed) * left
    return responses
