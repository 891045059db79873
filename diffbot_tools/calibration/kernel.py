"""Run the compiled filter over the arrays of a drive and compute the log likelihood of each measurement.

The functions of :mod:`diffbot_control.filter` for motion, measurements and corrections are compiled, as in the
simulation. The first ten states are the states of the filter with all errors. They are followed by the time-correlated
errors of single sources.
"""

from __future__ import annotations

import functools
import math
from typing import Any, NamedTuple

import numpy as np

from diffbot_control.filter import kalman
from diffbot_control.filter.config import options_of
from diffbot_control.filter.ekf import correct_state, move_state
from diffbot_control.filter.models import (
    POSE_FIX,
    WHEELS,
    Expected,
    Motion,
    Reading,
    TurnRate,
    expect,
    is_angle,
    is_defined,
    rate_expectation,
    size_of,
    slip_covariance,
)
from diffbot_control.filter.noise import inflation_after
from diffbot_control.filter.odometry import MESSAGE, Densities, motion_noise
from diffbot_control.filter.state import Options, reset_pose
from diffbot_control.ros.parameters.ekf import EkfNodeConfig
from diffbot_core.geometry import Point, Pose
from diffbot_core.kinematics import Twist, TwistCovariance, add_twist_covariance, scale_twist_covariance
from diffbot_sim.compiled_kalman import factorise
from diffbot_sim.jit import compile_kernel
from diffbot_tools.calibration.events import RESET, STATES, UNKNOWN_RATE, Array, Events, Odometry

NUMBERS, TERM, RATES, WHITE, COLUMNS = 0, 1, 2, 3, 6
"""Columns of the result: count of numbers; log likelihood; log likelihood of the turn rates since the previous
measurement; whitened innovation (3 columns)."""
MAX_DELAY = 0.6
"""[s] largest dead time of the odometry in the search"""
_LOG_2PI = math.log(2.0 * math.pi)
_NANO = 1e-9
"""[s] Times that differ by less are equal."""
_MIN_DT = 1e-3
"""[s] Shortest time that is assumed between two measurements of one source."""
_MIN_SEPARATION = 1e-2
"""Smallest estimated wheel separation, as a share of the configured one. The filter divides by this share."""

compiled = functools.cache(compile_kernel)


class Settings(NamedTuple):
    """Settings of a filter. The sensor noise is set by factors on the standard deviations in the events."""

    options: Options
    """options with all ten states. Wheel errors are never reset. See :func:`_fuse` for measurements beyond the gate."""
    densities: Densities
    by_message: bool
    """use the covariance of odometry messages that have one"""
    odometry_covariance_scale: float
    delay: float
    """[s] dead time of the odometry"""
    times: Any
    """(s,) [s] correlation time of the errors of each sensor; 0 if the errors are independent"""
    factors: Any
    """(s + 1, 2) factors on the standard deviations of each sensor: of positions and ranges, and of angles. The last
    row, for poses that were set by hand, is 1"""
    gyro_factor: float
    """factor on the standard deviation of the turn rates"""


class Filtered(NamedTuple):
    """Result of filtering a drive."""

    result: Array
    """(k, COLUMNS) figures of each measurement. NUMBERS is 0 for a reset, and for a landmark at the robot's place."""
    x: Array
    """(n,) states at the end"""
    P: Array
    """(n, n) covariance of the states at the end"""


class _Progress(NamedTuple):
    """Progress of the filter through the odometry."""

    now: float
    """[s]"""
    message: int
    """index of the present message"""
    rated: int
    """index of the last message whose turn rate has corrected the filter; -1 before the first"""
    slip: float
    """[rad/s^0.5] difference between this turn rate and the turn rate of the wheels, times the square root of the
    message's duration; 0 if the difference was inside the gate"""
    log_likelihood: float
    """log likelihood of the turn rates since the previous measurement"""


def settings_of(config: EkfNodeConfig) -> Settings:
    """Return the settings of a filter for its parameters."""
    localization, odometry = config.localization, config.localization.odometry
    points = tuple(config.landmarks.points().values())
    options = options_of(localization, config.wheels.wheel_separation, points)
    return Settings(
        # The type of the tuple depends on its length, so each length would be compiled again.
        options._replace(size=STATES, max_radius_error=0.0, max_separation_error=0.0, times=()),
        odometry.densities,
        odometry.odometry_noise == MESSAGE,
        odometry.odometry_covariance_scale,
        odometry.odometry_delay,
        np.array(options.times),
        np.ones((len(options.times) + 1, 2)),
        gyro_factor=1.0,
    )


def run_events(events: Events, settings: Settings) -> Filtered:
    """Filter a drive; the compiled code releases the interpreter's lock."""
    n = STATES + events.errors
    x, P, result = np.zeros(n), np.zeros((n, n)), np.zeros((len(events.measurements.time), COLUMNS))
    x[WHEELS:STATES] = settings.options.errors
    P[range(WHEELS, STATES), range(WHEELS, STATES)] = settings.options.variances
    compiled(_run_filter)(events, _turn_rates(events, settings), x, P, result, settings)
    return Filtered(result, x, P)


def _turn_rates(events: Events, settings: Settings) -> Array:
    """Return the mean turn rate [rad/s] of the gyro over each odometry message, and its variance times the duration.

    The variance times the duration of the message [rad^2/s] is inf where the turn rate was not measured. The choice of
    the turn rates does not depend on the delay. Otherwise the likelihood would jump where a delay adds a turn rate.
    """
    (start, end, *_), (time, angle, variance) = events.odometry, events.rates
    found = np.full((len(end), 2), (0.0, math.inf))
    if len(time) > 0:
        begin, stop = start + settings.delay, end + settings.delay
        dt = stop - begin
        sums = [np.interp(stop, time, one) - np.interp(begin, time, one) for one in (angle, variance)]
        inside = (start > time[0] - _NANO) & (end + max(settings.delay, MAX_DELAY) < time[-1] + _NANO)
        known = inside & (sums[1] < UNKNOWN_RATE * dt**2)
        known[0] = False  # The first message also acts before its start, where the robot moved differently.
        found[known] = np.column_stack((sums[0] / dt, settings.gyro_factor**2 * sums[1] / dt))[known]
    return found


def _run_filter(events: Events, rates: Array, x: Array, P: Array, result: Array, s: Settings) -> None:
    """Filter a drive whose first measurement is a reset.

    Args:
        events: events of the drive.
        rates: (n, 2) result of :func:`_turn_rates`.
        x: mean (n,) before the first reset, replaced by the mean at the end.
        P: covariance (n, n) before the first reset, replaced by the covariance at the end.
        result: (k, COLUMNS) zeros, filled with the figures of each measurement.
        s: settings.
    """
    measured, progress = events.measurements, _Progress(0.0, 0, -1, 0.0, 0.0)
    accepted = np.full(len(measured.time), -math.inf)  # [s] time of the last measurement of each source inside the gate
    for k in range(len(measured.time)):
        sensor, slot, source, now = measured.sensor[k], measured.slot[k], measured.source[k], float(measured.time[k])
        progress = _advance(x, P, events.odometry, rates, progress, now, s)
        result[k, RATES] = progress.log_likelihood
        is_reset = measured.kind[k] == RESET
        kind = POSE_FIX if is_reset else int(measured.kind[k])
        m = size_of(kind)
        z, R = measured.values[k, :m].copy(), measured.R[k, :m, :m].copy()
        for i in range(m):
            for j in range(m):
                R[i, j] *= s.factors[sensor, int(is_angle(kind, i))] * s.factors[sensor, int(is_angle(kind, j))]
        if is_reset:
            reset_pose(x, P, Pose(z[0], z[1], z[2]), R)
            accepted[:] = -math.inf
            if slot >= 0:
                _start_errors(P, R, slot)
            continue
        reading = Reading(kind, 0, 0, 0.0, z, R, Point(measured.place[k, 0], measured.place[k, 1]))
        if not is_defined(reading, x):
            continue
        expected, inflation = expect(reading, x, P), 1.0
        if slot >= 0:
            _predict_errors(x, P, expected, slot, math.exp(-max(float(measured.gap[k]), _MIN_DT) / s.times[sensor]))
        elif accepted[source] > -math.inf:
            inflation = inflation_after(now - accepted[source], s.times[sensor])
        if _fuse(x, P, expected, inflation, s, result[k]) <= s.options.gates[m - 1]:
            accepted[source] = now


def _fuse(x: Array, P: Array, expected: Expected, inflation: float, s: Settings, figures: Array) -> float:
    """Correct with a measurement, write its figures (COLUMNS,) and return its NIS.

    Beyond the gate the gain is multiplied by gate / NIS, and the NIS in the likelihood is gate (1 + ln(NIS / gate)),
    whose derivative is this weight.
    """
    m, white, S = len(expected.y), expected.y.copy(), kalman.innovation_covariance(P, expected.H, expected.R)
    factorise(S, white)
    gate, log_det, nis = s.options.gates[m - 1], 0.0, 0.0
    for i in range(m):
        figures[WHITE + i] = white[i]
        log_det += 2.0 * math.log(S[i, i])
        nis += white[i] * white[i]
    beyond = nis > gate
    counted = gate * (1.0 + math.log(nis / gate)) if beyond else nis
    figures[NUMBERS] = m
    figures[TERM] = -0.5 * (m * _LOG_2PI + log_det + counted) / inflation
    correct_state(x, P, s.options, expected, inflation, nis / gate if beyond else 1.0)
    if abs(1.0 + x[WHEELS + 2]) < _MIN_SEPARATION:
        x[WHEELS + 2] = _MIN_SEPARATION - 1.0
    return nis


def _start_errors(P: Array, R: Array, slot: int) -> None:
    """Initialise the states from ``slot`` on with the error of the fix that reset the pose, of covariance R (3, 3)."""
    for i in range(3):
        for j in range(3):
            P[slot + i, slot + j] = R[i, j]
            P[i, slot + j] = P[slot + j, i] = -R[i, j]


def _predict_errors(x: Array, P: Array, expected: Expected, slot: int, c: float) -> None:
    """Predict the error states of a source, which begin at ``slot``, and add them to the model of a measurement.

    Each new error is ``c`` times the previous error plus an independent part, so that its covariance stays R. The
    measurement has no other error, so its R becomes zero.
    """
    y, H, R = expected
    m = len(y)
    for i in range(slot, slot + m):
        x[i] *= c
        for j in range(len(x)):
            P[i, j] *= c
        for j in range(len(x)):
            P[j, i] *= c
    for i in range(m):
        for j in range(m):
            P[slot + i, slot + j] += (1.0 - c * c) * R[i, j]
            R[i, j] = 0.0
        H[i, slot + i] = 1.0
        # An angle is not wrapped again, since errors are small.
        y[i] -= x[slot + i]


def _advance(
    x: Array, P: Array, odometry: Odometry, rates: Array, progress: _Progress, until: float, s: Settings
) -> _Progress:
    """Move to ``until`` [s].

    Message k acts from start + delay to end + delay. The first message also acts before, and the last one also after.
    Before a message acts, its turn rate corrects the gyro bias and the wheel errors, as in :func:`ekf.take_rate`.
    """
    now, message, rated, slip, _ = progress
    last, log_likelihood = len(odometry.end) - 1, 0.0
    while until - now > _NANO:
        while message < last and odometry.end[message] + s.delay <= now + _NANO:
            message += 1
        whole = odometry.end[message] + s.delay
        end = until if message == last or whole > until else whole
        rate, variance = rates[message, 0], rates[message, 1]
        if rated != message and variance < math.inf:
            duration, figures = whole - now, np.zeros(COLUMNS)
            motion = _motion_of(odometry, message, duration, TurnRate(rate, variance / duration), 0.0, s)
            found = rate_expectation(x, motion, s.options.separation)
            H = found.H
            if len(odometry.smooth) > 0:
                # These derivatives contain neither the error of the message nor the error of the gyro.
                smooth = Motion(_smooth(odometry, message), duration, motion.covariance, TurnRate(0.0, math.inf), 0.0)
                H = rate_expectation(x, smooth, s.options.separation).H
            expected = Expected(np.array((found.y,)), H, np.array(((found.variance,),)))
            beyond = _fuse(x, P, expected, 1.0, s, figures) > s.options.gates[0]
            rated, slip = message, math.sqrt(duration) * found.y if beyond else 0.0
            log_likelihood += float(figures[TERM])
        dt = end - now
        part = slip / math.sqrt(dt) if rated == message else 0.0
        move_state(x, P, s.options, _motion_of(odometry, message, dt, TurnRate(rate, variance / dt), part, s))
        now = end
    return _Progress(now, message, rated, slip, log_likelihood)


def _motion_of(odometry: Odometry, index: int, dt: float, rate: TurnRate, slip: float, s: Settings) -> Motion:
    """Return the motion during ``dt`` [s] of an odometry message.

    ``slip`` [rad/s] is the difference between the turn rates of gyro and wheels, or 0 if it is inside the gate.
    """
    twist, row = Twist(odometry.twist[index, 0], odometry.twist[index, 1]), odometry.covariance[index]
    if s.by_message and (row[0] != 0.0 or row[1] != 0.0 or row[2] != 0.0):
        share = (odometry.end[index] - odometry.start[index]) / dt
        given, lateral = TwistCovariance(row[0], row[1], row[2]), 0.0
        covariance = scale_twist_covariance(given, share * s.odometry_covariance_scale)
    else:
        covariance, lateral = motion_noise(_smooth(odometry, index), dt, s.densities)
    covariance = add_twist_covariance(covariance, slip_covariance(slip, s.options.separation))
    return Motion(twist, dt, covariance, rate, lateral)


def _smooth(odometry: Odometry, index: int) -> Twist:
    """Return the twist at which noise and derivatives of an odometry message are evaluated."""
    source = odometry.smooth if len(odometry.smooth) > 0 else odometry.twist
    return Twist(source[index, 0], source[index, 1])
