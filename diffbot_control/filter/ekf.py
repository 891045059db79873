"""The extended Kalman filter as functions of arrays: prediction, gate, correction, relocation, reported estimate.

The functions run as plain Python and, compiled unchanged, in the simulation. :mod:`state` describes their memory.

The gate treats fixes and other measurements differently:

- A fix beyond the gate is rejected. It starts a second hypothesis, the candidate, which is also predicted. If the
  following fixes agree with the candidate, the robot was carried away or has slipped. Then the candidate replaces the
  estimate. Outliers do not agree with each other.
- Any other measurement beyond the gate corrects the estimate with a gain multiplied by bound / NIS. This correction
  decreases with 1 / |y|: an outlier does little harm, but a wrong estimate still converges.
"""

from __future__ import annotations

import math

import numpy as np

from diffbot_control.filter import kalman, noise, state
from diffbot_control.filter.models import (
    BEARING,
    BIAS,
    HEADING,
    LANDMARK,
    MAX_SLIP,
    POSE_FIX,
    SENSOR,
    UNKNOWN_HEADING,
    WHEELS,
    Array,
    Expected,
    Motion,
    Reading,
    arc_correction,
    covariance_with_rate,
    expect,
    gyro_share,
    is_angle,
    is_defined,
    is_fix,
    rate_expectation,
    size_of,
    transition,
)
from diffbot_control.filter.state import FilterState, Options
from diffbot_core.geometry import Pose, wrap_angle
from diffbot_core.kinematics import scale_twist_covariance

ACCEPTED, REJECTED, RELOCATED, IGNORED, WEIGHED = 0, 1, 2, 3, 4
"""Outcomes of a measurement. ACCEPTED: it corrected the estimate. REJECTED: the fix corrected or started the candidate.
RELOCATED: the candidate replaced the estimate. IGNORED: its expected value is not defined at the estimate. WEIGHED: it
corrected the estimate with a reduced gain."""
_SLACK_UP, _SLACK_DOWN = 0.2, 0.05
"""Increase per rejected fix, and decrease per accepted fix, of the slack: the log of a factor on the bound of the gate.
The slack grows if the gate rejects more than one fifth of the fixes, which shows that the covariances are too small."""
_RELOCATION_TIME = 1.5
"""[s] If all fixes are rejected for this time, the newest fix relocates the filter, even if the fixes do not agree."""
_TURNED_VARIANCE = 0.04
"""[rad^2] If the heading variance is larger, a correction moves the robot along an arc. Otherwise a straight line is
used, which agrees with the arc to first order."""
_SENSOR_AS_CONFIGURED = 0.5
"""Prior probability that the errors of the landmark sensor are exactly as configured."""
_SLIP_TIME = 2.0
"""[s] Time constant of the mean innovation of the gyro. It is longer than an acceleration, during which a gyro with a
delay disagrees with the wheels."""
_SLIP_BOUND = 40.0
"""Bound of the squared mean innovation over its variance; white innovations do not exceed it."""
_SLIP_GROWTH = 9.0
"""Squared ratio of the innovation that the slip will finally cause to the mean innovation when it is detected."""


def predict(filter_: FilterState, options: Options, motion: Motion) -> None:
    """Predict the estimate and the candidate over a motion."""
    if options.fuzzy:
        factor = noise.q_scale(filter_.noise[0])
        covariance = scale_twist_covariance(motion.covariance, factor)
        motion = Motion(motion.twist, motion.dt, covariance, motion.rate, factor * motion.lateral)
    move_state(filter_.x, filter_.P, options, motion)
    if filter_.gate[state.HAS_CANDIDATE] > 0.0:
        move_state(filter_.candidate, filter_.candidate_P, options, motion)
    if filter_.gate[state.REJECTIONS] > 0.0:
        filter_.gate[state.ELAPSED] += motion.dt
    covariance = covariance_with_rate(motion.covariance, gyro_share(motion.covariance, motion.rate))
    squared = motion.dt * motion.dt
    filter_.travelled[0] += squared * covariance.var_v + motion.lateral
    filter_.travelled[1] += squared * covariance.var_omega


def move_state(x: Array, P: Array, options: Options, motion: Motion) -> None:
    """Predict mean ``x`` (n,) and covariance ``P`` (n, n) over a motion in place."""
    moved = transition(x, motion, options.separation)
    for i in range(options.size - WHEELS):
        if i < 3 and options.variances[i] > 0.0:
            moved.Q[WHEELS + i, WHEELS + i] = options.wheel_walk * motion.dt
        if WHEELS + i == BIAS and options.variances[i] > 0.0:
            moved.Q[BIAS, BIAS] = options.bias_walk * motion.dt
    P[:, :] = kalman.propagate(P, moved.F, moved.Q)
    x[:] = moved.x


def normalised_square(y: Array, S: Array) -> float:
    """Return y' S^-1 y for m <= 3 by the factorisation S = L D L'; nan if S is not positive definite."""
    m, first, y_0 = len(y), float(S[0, 0]), float(y[0])
    if not first > 0.0:
        return math.nan
    total = y_0 * y_0 / first
    if m == 1:
        return total
    p = float(S[1, 0]) / first
    second, y_1 = float(S[1, 1]) - p * p * first, float(y[1]) - p * y_0
    if not second > 0.0:
        return math.nan
    total += y_1 * y_1 / second
    if m == 2:
        return total
    q = float(S[2, 0]) / first
    r = (float(S[2, 1]) - q * p * first) / second
    third, y_2 = float(S[2, 2]) - q * q * first - r * r * second, float(y[2]) - q * y_0 - r * y_1
    return total + y_2 * y_2 / third if third > 0.0 else math.nan


def take(filter_: FilterState, options: Options, reading: Reading) -> int:
    """Apply the gate to a measurement, correct with it, and return the outcome, e.g. ACCEPTED."""
    if not is_defined(reading, filter_.x):
        return IGNORED
    expected, S = innovation(filter_, options, reading)
    nis = normalised_square(expected.y, S)
    bound = options.gates[size_of(reading.kind) - 1]
    if is_fix(reading.kind):
        bound *= math.exp(filter_.gate[state.SLACK])
    last, outcome = filter_.last[reading.place], REJECTED
    if 0.0 <= nis <= bound:
        _accept(filter_, options, reading, expected, S, nis)
        outcome = ACCEPTED
    elif is_fix(reading.kind):
        last[state.VALID] = 0.0
        outcome = _reject(filter_, options, reading, bound)
    elif not math.isnan(nis):
        factor = _inflation(filter_, options, reading)
        filter_.shift[:] += correct_state(filter_.x, filter_.P, options, expected, factor, nis / bound)
        outcome = WEIGHED
    last[state.NIS], last[state.OUTCOME] = nis, outcome
    return outcome


def innovation(filter_: FilterState, options: Options, reading: Reading) -> tuple[Expected, Array]:
    """Compare a measurement with the estimate; return also the innovation covariance S (m, m) at the gate.

    R is the claimed covariance times the estimated scale. The measurement must be defined at the estimate.
    """
    expected = _expected(reading, filter_.x, filter_.P, filter_.noise[reading.source], options)
    return expected, kalman.innovation_covariance(filter_.P, expected.H, expected.R)


def _expected(reading: Reading, x: Array, P: Array, row: Array, options: Options) -> Expected:
    """Compare a measurement with a state; ``row`` is the noise statistic of its source, whose scale multiplies R."""
    expected = expect(reading, x, P)
    if not options.finds_noise and not options.fuzzy:
        return expected
    position, angle = noise.scale_of(row, False), noise.scale_of(row, True)
    if position == 1.0 and angle == 1.0:
        return expected
    R, m = expected.R.copy(), len(expected.y)
    for i in range(m):
        for j in range(m):
            scale_i = angle if is_angle(reading.kind, i) else position
            scale_j = angle if is_angle(reading.kind, j) else position
            # The covariance of the linearisation error, which R also contains, is not scaled.
            R[i, j] += (math.sqrt(scale_i * scale_j) - 1.0) * reading.R[i, j]
    return Expected(expected.y, expected.H, R)


def _inflation(filter_: FilterState, options: Options, reading: Reading) -> float:
    """Return the factor by which R is inflated for time-correlated errors."""
    last, time = filter_.last[reading.place], options.times[reading.source]
    if last[state.VALID] == 0.0 or not (options.finds_noise or time > 0.0):
        return 1.0
    dt = reading.time - float(last[state.TIME])
    return noise.inflation(filter_.noise[reading.source], dt, time, reading.kind >= LANDMARK)


def correct_state(x: Array, P: Array, options: Options, expected: Expected, inflation: float, weight: float) -> Array:
    """Correct mean ``x`` (n,) and covariance ``P`` (n, n) in place, and return the shift (n,) of the mean.

    Args:
        x: mean.
        P: covariance.
        options: options of the filter.
        expected: measurement compared with the mean.
        inflation: factor on R.
        weight: factor on the innovation covariance S, ignored if below 1; NIS / bound for a measurement beyond the
            gate.
    """
    R = inflation * expected.R
    if weight > 1.0:
        R = R + (weight - 1.0) * kalman.innovation_covariance(P, expected.H, R)
    uncertain = P[2, 2] > _TURNED_VARIANCE
    shift, corrected = kalman.correct(P, expected.y, expected.H, R)
    P[:, :] = corrected
    if uncertain:
        turn = float(shift[2])
        shift[0], shift[1] = arc_correction(float(shift[0]), float(shift[1]), turn)
        sine, cosine = math.sin(turn), math.cos(turn)
        _turn_rows(P, sine, cosine)
        _turn_rows(P.T, sine, cosine)
    x += shift
    x[2] = wrap_angle(float(x[2]))
    if options.max_radius_error > 0.0:
        _reset_implausible_wheels(x, P, options)
    return shift


def _turn_rows(P: Array, sine: float, cosine: float) -> None:
    """Rotate the rows of x and y of a matrix (n, n) in place."""
    for i in range(len(P)):
        first, second = float(P[0, i]), float(P[1, i])
        P[0, i], P[1, i] = cosine * first - sine * second, sine * first + cosine * second


def _reset_implausible_wheels(x: Array, P: Array, options: Options) -> None:
    """Reset the wheel errors if one of them exceeds its bound, which shows that a wheel slips."""
    errors, variances = options.errors, options.variances
    radii = max(abs(float(x[3]) - errors[0]), abs(float(x[4]) - errors[1]))
    if radii <= options.max_radius_error and abs(float(x[5]) - errors[2]) <= options.max_separation_error:
        return
    P[WHEELS:BIAS, :] = 0.0
    P[:, WHEELS:BIAS] = 0.0
    for i in range(3):
        x[WHEELS + i], P[WHEELS + i, WHEELS + i] = errors[i], variances[i]


def _accept(filter_: FilterState, options: Options, reading: Reading, expected: Expected, S: Array, nis: float) -> None:
    """Correct with a measurement within the gate, and update the noise statistic of its source."""
    row, last, gate = filter_.noise[reading.source], filter_.last[reading.place], filter_.gate
    if is_fix(reading.kind):
        gate[state.REJECTIONS] = gate[state.ELAPSED] = gate[state.AGREEING] = gate[state.HAS_CANDIDATE] = 0.0
        gate[state.SLACK] = max(gate[state.SLACK] - _SLACK_DOWN, 0.0)
    factor, m, paired = _inflation(filter_, options, reading), len(expected.y), last[state.VALID] == 1.0 + reading.kind
    x, y, theta, var_theta = float(filter_.x[0]), float(filter_.x[1]), float(filter_.x[2]), float(filter_.P[2, 2])
    product = 0.0
    for i in range(m):
        u = float(expected.y[i]) / math.sqrt(float(S[i, i]))
        product += u * float(last[state.NORMALISED + i])
        last[state.NORMALISED + i] = u
    noise.add_innovation(row, nis, product, m, paired)
    shift = correct_state(filter_.x, filter_.P, options, expected, factor, 1.0)
    if options.fuzzy and reading.source == 0:
        noise.add_drift(row, last[state.NORMALISED : state.NORMALISED + 3], m)
    if paired and (options.fuzzy or options.finds_noise or options.times[reading.source] > 0.0):
        _update_noise(filter_, options, reading, expected, x, y)
    last[state.VALID], last[state.TIME] = 1.0 + reading.kind, reading.time
    last[state.POSE], last[state.POSE + 1], last[state.POSE + 2], last[state.VAR_THETA] = x, y, theta, var_theta
    last[state.ALONG], last[state.TURN] = filter_.travelled[0], filter_.travelled[1]
    for i in range(m):
        last[state.INNOVATION + i] = expected.y[i]
    for i in range(len(shift)):
        last[state.SHIFT + i] = filter_.shift[i]
        filter_.shift[i] += shift[i]


def _update_noise(
    filter_: FilterState, options: Options, reading: Reading, expected: Expected, x: float, y: float
) -> None:
    """Add the previous and this measurement to the noise statistic, and inflate P if the estimated R increases.

    ``x`` and ``y`` [m] are the estimated position before the correction.
    """
    row, last = filter_.noise[reading.source], filter_.last[reading.place]
    shift = filter_.shift - last[state.SHIFT :]
    dx, dy = x - float(last[state.POSE]) - float(shift[0]), y - float(last[state.POSE + 1]) - float(shift[1])
    # A heading error rotates the path and so moves the end of the path sideways.
    var_position = float(filter_.travelled[0] - last[state.ALONG]) + (dx * dx + dy * dy) * float(last[state.VAR_THETA])
    var_heading = float(filter_.travelled[1] - last[state.TURN])
    sums, H, moved = np.zeros((2, 5)), expected.H, expected.H @ shift
    for i in range(len(moved)):
        y_new, y_old, weight = float(expected.y[i]), float(last[state.INNOVATION + i]), 1.0 / float(reading.R[i, i])
        difference = y_new - y_old + float(moved[i])
        H_x, H_y, H_theta = float(H[i, 0]), float(H[i, 1]), float(H[i, 2])
        part = sums[1 if is_angle(reading.kind, i) else 0]
        part[noise.DIFFERENCE] += 0.5 * difference * difference * weight
        part[noise.MOTION] += 0.5 * ((H_x * H_x + H_y * H_y) * var_position + H_theta * H_theta * var_heading) * weight
        part[noise.PRODUCT] += y_new * y_old * weight
        part[noise.SQUARE] += y_new * y_new * weight
        part[4] += 1.0
    old_factor = _noise_factor(row, reading)
    noise.add_pair(row, sums, reading.time - float(last[state.TIME]))
    if options.fuzzy:
        noise.update_scale_by_rules(row)
    elif options.times[reading.source] == 0.0:
        noise.update_scale_and_time(row)
    growth = _noise_factor(row, reading) / old_factor
    if growth > 1.0:
        # Past corrections used an R that was too small.
        filter_.P[:3, :] *= math.sqrt(growth)
        filter_.P[:, :3] *= math.sqrt(growth)


def _noise_factor(row: Array, reading: Reading) -> float:
    """Return the estimated factor on R of a source, as the geometric mean over the scalars of a measurement."""
    position, angle = noise.scale_of(row, False), noise.scale_of(row, True)
    share = 1.0 / 3.0 if reading.kind == POSE_FIX else 0.5 if reading.kind == LANDMARK else 0.0
    if reading.kind in (HEADING, BEARING):
        share = 1.0
    inflation = noise.inflation(row, float(row[noise.PERIOD]), 0.0, reading.kind >= LANDMARK)
    return float(position ** (1.0 - share) * angle**share) * inflation


def _reject(filter_: FilterState, options: Options, reading: Reading, bound: float) -> int:
    """Correct or restart the candidate with a fix beyond the gate; return REJECTED or RELOCATED."""
    gate, x, P = filter_.gate, filter_.candidate, filter_.candidate_P
    row = filter_.noise[reading.source]
    agrees = False
    if gate[state.HAS_CANDIDATE] > 0.0:
        expected = _expected(reading, x, P, row, options)
        agrees = 0.0 <= normalised_square(expected.y, kalman.innovation_covariance(P, expected.H, expected.R)) <= bound
        if agrees:
            correct_state(x, P, options, expected, 1.0, 1.0)
    if not agrees:
        x[:] = filter_.x
        P[:, :] = filter_.P
        pose_P = np.zeros((3, 3))
        m = size_of(reading.kind)
        pose_P[2, 2] = UNKNOWN_HEADING
        pose_P[:m, :m] = reading.R
        state.reset_pose(
            x, P, Pose(float(reading.z[0]), float(reading.z[1]), float(reading.z[2]) if m == 3 else float(x[2])), pose_P
        )
    gate[state.HAS_CANDIDATE], gate[state.AGREEING] = 1.0, gate[state.AGREEING] + 1.0 if agrees else 1.0
    gate[state.REJECTIONS] += 1.0
    gate[state.SLACK] += _SLACK_UP
    enough = gate[state.AGREEING] >= options.relocation_fixes
    if not enough and (gate[state.REJECTIONS] < options.relocation_fixes or gate[state.ELAPSED] < _RELOCATION_TIME):
        return REJECTED
    filter_.x[:] = x
    filter_.P[:, :] = P
    # Rejected fixes that agree with each other do not show that the gate is too narrow.
    slack = max(gate[state.SLACK] - gate[state.AGREEING] * _SLACK_UP, 0.0) if enough else gate[state.SLACK]
    gate[: state.HAS_CANDIDATE + 1] = 0.0
    gate[state.SLACK] = slack
    state.unpair(filter_)
    return RELOCATED


def take_rate(filter_: FilterState, options: Options, motion: Motion) -> float:
    """Correct the gyro bias and the wheel errors with the turn rate of a motion.

    When a wheel starts or stops slipping, the innovations keep one sign. The variances of the radius errors are then
    increased until they explain the innovations, and the filter estimates the radii again. A turn rate beyond the gate
    does not increase them, so that the filter does not explain a broken gyro by slip. Equal slip of both wheels is not
    detected, since it does not change the turn rate.

    Returns:
        The difference [rad/s] between gyro and wheels if it is beyond the gate, else 0. Beyond the gate, the turn rate
        corrects with a reduced gain.
    """
    rate, bound = rate_expectation(filter_.x, motion, options.separation), options.gates[0]
    y, R = np.array((rate.y,)), np.array(((rate.variance,),))
    S = float(kalman.innovation_covariance(filter_.P, rate.H, R)[0, 0])
    nis = rate.y * rate.y / S
    filter_.shift[:] += correct_state(filter_.x, filter_.P, options, Expected(y, rate.H, R), 1.0, nis / bound)
    if nis > bound:
        return rate.y
    if options.max_radius_error > 0.0:
        _inflate_radii_on_slip(filter_, motion.dt, rate.y, S, float(rate.H[0, 3]) ** 2 + float(rate.H[0, 4]) ** 2)
    return 0.0


def _inflate_radii_on_slip(filter_: FilterState, dt: float, y: float, S: float, sensitivity: float) -> None:
    """Increase the variances of the radius errors if the innovations of the turn rate keep one sign.

    Args:
        filter_: filter that estimates the radius errors.
        dt: duration of the step [s].
        y: innovation of the turn rate [rad/s].
        S: variance of the innovation [rad^2/s^2].
        sensitivity: sum of the squared derivatives of the turn rate with respect to both radius errors [rad^2/s^2].
    """
    share = dt / (_SLIP_TIME + dt)
    mean = filter_.gate[state.DISAGREEMENT] + share * (y / math.sqrt(S) - filter_.gate[state.DISAGREEMENT])
    filter_.gate[state.DISAGREEMENT] = mean
    squared = mean * mean * S
    # The mean of white innovations has the variance share / (2 - share). The second condition fails for wheels at rest.
    if mean * mean * (2.0 - share) > _SLIP_BOUND * share and squared <= MAX_SLIP * MAX_SLIP * sensitivity:
        filter_.gate[state.DISAGREEMENT] = 0.0
        # Either radius may have changed, so both variances increase equally.
        variance = min(_SLIP_GROWTH * squared / sensitivity, MAX_SLIP * MAX_SLIP)
        filter_.P[3, 3] += variance
        filter_.P[4, 4] += variance


def average(filter_: FilterState, options: Options) -> tuple[Array, Array]:
    """Return mean (n,) and covariance (n, n), averaged over two hypotheses for the wheels and for the landmark sensor.

    Hypothesis 1: the errors are exactly as configured. Hypothesis 2: they differ. Estimating an error that does not
    exist costs accuracy, so neither hypothesis alone is good for all robots. The filter runs under hypothesis 2. Its
    estimate conditioned on the configured errors is the estimate under hypothesis 1. The Bayes factor of hypothesis 1
    is the current density of the errors at the configured values, divided by the initial density there (Savage-Dickey
    density ratio).
    """
    x, P = filter_.x.copy(), filter_.P.copy()
    if options.size > WHEELS:
        _average_over(x, P, options, WHEELS, options.wheels_as_configured)
    if options.size > SENSOR:
        _average_over(x, P, options, SENSOR, _SENSOR_AS_CONFIGURED)
    return x, P


def _average_over(x: Array, P: Array, options: Options, first: int, prior: float) -> None:
    """Average in place over both hypotheses on the three errors that begin at index ``first``.

    ``prior`` is the prior probability of hypothesis 1.
    """
    x_1, P_1, log_bayes = x, P, 0.0
    for i in range(first, first + 3):
        variance, initial = float(P_1[i, i]), options.variances[i - WHEELS]
        if initial > 0.0 and variance > 0.0:
            difference = options.errors[i - WHEELS] - float(x_1[i])
            log_bayes += 0.5 * (math.log(initial / variance) - difference * difference / variance)
            x_1, P_1 = kalman.condition(x_1, P_1, i, options.errors[i - WHEELS])
    # Posterior probability of hypothesis 1; the exponent is bounded so that exp does not overflow.
    probability = prior / (prior + (1.0 - prior) * math.exp(min(-log_bayes, 700.0)))
    between = x_1 - x
    P += probability * (P_1 - P) + probability * (1.0 - probability) * between * between.reshape(len(between), 1)
    x += probability * between
    x[2] = wrap_angle(float(x[2]))
