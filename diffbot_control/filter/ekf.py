"""The filter as functions of arrays: predict, correct, gate, relocation, and the estimate that is reported.

The functions run as plain Python and, compiled unchanged, in the simulation. :mod:`state` describes their memory.

The gate treats fixes and other measurements differently:

- A fix beyond the gate is rejected. It starts a second hypothesis, the candidate, which the same odometry moves.
  Outliers do not agree with each other. The fixes of a robot that was carried away or has slipped do agree, and then
  the candidate replaces the estimate.
- Any other measurement beyond the gate corrects the estimate with its gain multiplied by bound / NIS. The correction
  decreases with 1 / |y|, so a misread number does little harm, and a filter that is lost still converges.
"""

from __future__ import annotations

import math

import numpy as np

from diffbot_control.filter import kalman, noise, state
from diffbot_control.filter.models import (
    BIAS,
    HEADING,
    LANDMARK,
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
"""Outcomes of a measurement: it corrected the estimate; the fix was used for the candidate; the candidate replaced the
estimate; the measurement is not defined here; it corrected the estimate with a part of the gain."""
_SLACK_UP, _SLACK_DOWN = 0.2, 0.05
"""Change of the slack at a rejected and at an accepted fix: a gate that rejects more than a fifth is itself wrong."""
_RELOCATION_TIME = 1.5
"""[s] After rejected fixes for this time the newest one relocates the filter, even if they do not agree."""
_TURNED_VARIANCE = 0.04
"""[rad^2] With a larger heading variance, a correction moves the robot along an arc; with a smaller one, arc and line
agree to first order."""
_EVEN = 0.5
"""Prior probability of each of two hypotheses."""
_SLIP_TIME = 2.0
"""[s] over which innovations of the gyro are averaged: longer than accelerations, during which a late gyro also
disagrees"""
_SLIP_BOUND = 40.0
"""Bound of the squared mean over its variance; white innovations do not reach it."""
_SLIP_GROWTH = 9.0
"""Square of the ratio of the final disagreement to the mean at detection."""
MAX_SLIP = 0.2
"""Largest relative error of a radius that is explained by slip."""


def predict(filter_: FilterState, options: Options, motion: Motion) -> None:
    """Move the estimate and the candidate."""
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
    """Move mean ``x`` (n,) and covariance ``P`` (n, n) in place."""
    moved = transition(x, motion, options.separation)
    for i in range(options.size - WHEELS):
        if i < 3 and options.variances[i] > 0.0:
            moved.Q[WHEELS + i, WHEELS + i] = options.wheel_walk * motion.dt
        if WHEELS + i == BIAS and options.variances[i] > 0.0:
            moved.Q[BIAS, BIAS] = options.bias_walk * motion.dt
    P[:, :] = kalman.propagate(P, moved.F, moved.Q)
    x[:] = moved.x


def normalised_square(y: Array, S: Array) -> float:
    """Return y' S^-1 y for a matrix S (m, m) with m <= 3, by S = L D L'; nan if it is not positive definite."""
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
    """Pass a measurement through the gate; return ACCEPTED, REJECTED, RELOCATED, IGNORED or WEIGHED."""
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
        outcome = _doubt(filter_, options, reading, bound)
    elif not math.isnan(nis):
        factor = _inflation(filter_, options, reading)
        filter_.shift[:] += correct_state(filter_.x, filter_.P, options, expected, factor, nis / bound)
        outcome = WEIGHED
    last[state.NIS], last[state.OUTCOME] = nis, outcome
    return outcome


def innovation(filter_: FilterState, options: Options, reading: Reading) -> tuple[Expected, Array]:
    """Compare a measurement with the estimate; return also the covariance S (m, m) of the innovation at the gate.

    R is the claimed covariance times the scale that was found. The measurement must be defined at the estimate.
    """
    expected = _expected(reading, filter_.x, filter_.P, filter_.noise[reading.source], options)
    return expected, kalman.innovation_covariance(filter_.P, expected.H, expected.R)


def _expected(reading: Reading, x: Array, P: Array, row: Array, options: Options) -> Expected:
    """Compare a measurement with a state; R is multiplied by the scale that was found for the source."""
    expected = expect(reading, x, P)
    if not options.finds_noise and not options.fuzzy:
        return expected
    position, angle = noise.scale_of(row, False), noise.scale_of(row, True)
    if position == 1.0 and angle == 1.0:
        return expected
    R, m = expected.R.copy(), len(expected.y)
    for i in range(m):
        for j in range(m):
            by_i = angle if is_angle(reading.kind, i) else position
            by_j = angle if is_angle(reading.kind, j) else position
            R[i, j] += (math.sqrt(by_i * by_j) - 1.0) * reading.R[i, j]
    return Expected(expected.y, expected.H, R)


def _inflation(filter_: FilterState, options: Options, reading: Reading) -> float:
    """Return the factor by which R is inflated for errors that are correlated in time."""
    last, time = filter_.last[reading.place], options.times[reading.source]
    if last[state.VALID] == 0.0 or not (options.finds_noise or time > 0.0):
        return 1.0
    dt = reading.time - float(last[state.TIME])
    return noise.inflation(filter_.noise[reading.source], dt, time, reading.kind >= LANDMARK)


def correct_state(x: Array, P: Array, options: Options, expected: Expected, inflation: float, weight: float) -> Array:
    """Correct mean and covariance in place, and return the shift (n,) of the mean.

    Args:
        x: mean (n,).
        P: covariance (n, n).
        options: options of the filter.
        expected: the measurement compared with the mean.
        inflation: factor on R in the gain.
        weight: factor on the covariance of the innovation in the gain; NIS / bound beyond the gate.
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
        _keep_wheels_possible(x, P, options)
    return shift


def _turn_rows(P: Array, sine: float, cosine: float) -> None:
    """Turn the rows of x and y of a matrix (n, n) in place."""
    for i in range(len(P)):
        first, second = float(P[0, i]), float(P[1, i])
        P[0, i], P[1, i] = cosine * first - sine * second, sine * first + cosine * second


def _keep_wheels_possible(x: Array, P: Array, options: Options) -> None:
    """Reset the errors of the wheels if one of them exceeds its bound, which shows that a wheel slips."""
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
    factor, m, paired = _inflation(filter_, options, reading), len(expected.y), last[state.VALID] > 0.0
    x, y, theta, var_theta = float(filter_.x[0]), float(filter_.x[1]), float(filter_.x[2]), float(filter_.P[2, 2])
    whiteness = 0.0
    for i in range(m):
        u = float(expected.y[i]) / math.sqrt(float(S[i, i]))
        whiteness += u * float(last[state.NORMALISED + i])
        last[state.NORMALISED + i] = u
    noise.observe(row, nis, whiteness, m, paired)
    shift = correct_state(filter_.x, filter_.P, options, expected, factor, 1.0)
    if options.fuzzy and reading.source == 0:
        noise.add_drift(row, last[state.NORMALISED : state.NORMALISED + 3], m)
    if paired and (options.fuzzy or options.finds_noise or options.times[reading.source] > 0.0):
        _learn(filter_, options, reading, expected, x, y)
    last[state.VALID], last[state.TIME] = 1.0, reading.time
    last[state.POSE], last[state.POSE + 1], last[state.POSE + 2], last[state.VAR_THETA] = x, y, theta, var_theta
    last[state.ALONG], last[state.TURN] = filter_.travelled[0], filter_.travelled[1]
    for i in range(m):
        last[state.INNOVATION + i] = expected.y[i]
    for i in range(len(shift)):
        last[state.SHIFT + i] = filter_.shift[i]
        filter_.shift[i] += shift[i]


def _learn(filter_: FilterState, options: Options, reading: Reading, expected: Expected, x: float, y: float) -> None:
    """Add a pair of neighbouring measurements to the noise statistic, and inflate P if R turns out to be too small.

    ``x`` and ``y`` [m] are the estimated position before the correction.
    """
    row, last = filter_.noise[reading.source], filter_.last[reading.place]
    shift = filter_.shift - last[state.SHIFT :]
    dx, dy = x - float(last[state.POSE]) - float(shift[0]), y - float(last[state.POSE + 1]) - float(shift[1])
    # An error of the heading turns the path and so moves its end sideways.
    spread = float(filter_.travelled[0] - last[state.ALONG]) + (dx * dx + dy * dy) * float(last[state.VAR_THETA])
    turned = float(filter_.travelled[1] - last[state.TURN])
    pairs, H, moved = np.zeros((2, 5)), expected.H, expected.H @ shift
    for i in range(len(moved)):
        now, before, weight = float(expected.y[i]), float(last[state.INNOVATION + i]), 1.0 / float(reading.R[i, i])
        newest, by_x, by_y, by_theta = now - before + float(moved[i]), float(H[i, 0]), float(H[i, 1]), float(H[i, 2])
        part = pairs[1 if is_angle(reading.kind, i) else 0]
        part[noise.DIFFERENCE] += 0.5 * newest * newest * weight
        part[noise.MOTION] += 0.5 * ((by_x * by_x + by_y * by_y) * spread + by_theta * by_theta * turned) * weight
        part[noise.PRODUCT] += now * before * weight
        part[noise.SQUARE] += now * now * weight
        part[4] += 1.0
    known = options.times[reading.source] > 0.0
    dt, was = reading.time - float(last[state.TIME]), _total(row, reading)
    noise.learn(row, pairs, dt)
    if options.fuzzy:
        noise.find_fuzzy(row)
    elif not known:
        noise.find(row)
    grown = _total(row, reading) / was
    if grown > 1.0:
        root = math.sqrt(grown)
        filter_.P[:3, :] *= root
        filter_.P[:, :3] *= root


def _total(row: Array, reading: Reading) -> float:
    """Return the factor on R that was found for a source, as the geometric mean over the numbers of a measurement."""
    position, angle = noise.scale_of(row, False), noise.scale_of(row, True)
    share = 1.0 / 3.0 if reading.kind == POSE_FIX else 0.5 if reading.kind == LANDMARK else 0.0
    if reading.kind == HEADING:
        share = 1.0
    inflation = noise.inflation(row, float(row[noise.PERIOD]), 0.0, reading.kind >= LANDMARK)
    return float(position ** (1.0 - share) * angle**share) * inflation


def _doubt(filter_: FilterState, options: Options, reading: Reading, bound: float) -> int:
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
    # If the fixes agree with each other, they were not noise, and the gate was right to reject them.
    slack = max(gate[state.SLACK] - gate[state.AGREEING] * _SLACK_UP, 0.0) if enough else gate[state.SLACK]
    gate[: state.HAS_CANDIDATE + 1] = 0.0
    gate[state.SLACK] = slack
    state.unpair(filter_)
    return RELOCATED


def take_rate(filter_: FilterState, options: Options, motion: Motion) -> float:
    """Correct the bias of the gyro and the errors of the wheels with the turn rate of a motion.

    When a wheel begins or ends to slip, the innovations keep one sign. Then the variances of the radii are increased
    until they explain the innovations, and the radii are estimated again. Turn rates beyond the gate do not count, so
    that a broken gyro is not explained by slip. The turn rate does not show slip that is equal at both wheels.

    Returns:
        The difference [rad/s] between gyro and wheels if it is beyond the gate, where it corrects with a part of the
        gain; 0 within the gate.
    """
    found, bound = rate_expectation(filter_.x, motion, options.separation), options.gates[0]
    y, R = np.array((found.y,)), np.array(((found.variance,),))
    expected = Expected(y, found.H, R)
    S = float(kalman.innovation_covariance(filter_.P, found.H, R)[0, 0])
    nis = found.y * found.y / S
    filter_.shift[:] += correct_state(filter_.x, filter_.P, options, expected, 1.0, nis / bound)
    if nis > bound:
        return found.y
    if options.max_radius_error > 0.0:
        _follow_slip(filter_, motion.dt, found.y, S, float(found.H[0, 3]) ** 2 + float(found.H[0, 4]) ** 2)
    return 0.0


def _follow_slip(filter_: FilterState, dt: float, y: float, S: float, sensitivity: float) -> None:
    """Increase the variances of the radii if innovations of the turn rate keep one sign.

    Args:
        filter_: a filter whose radii are states.
        dt: duration of the step [s].
        y: innovation [rad/s].
        S: its variance [rad^2/s^2].
        sensitivity: sum of the squared derivatives of the turn rate with respect to both radii [rad^2/s^2].
    """
    share = dt / (_SLIP_TIME + dt)
    mean = filter_.gate[state.DISAGREEMENT] + share * (y / math.sqrt(S) - filter_.gate[state.DISAGREEMENT])
    filter_.gate[state.DISAGREEMENT] = mean
    squared = mean * mean * S
    # The mean of white innovations has the variance share / (2 - share). Wheels at rest cannot slip.
    if mean * mean * (2.0 - share) > _SLIP_BOUND * share and squared <= MAX_SLIP * MAX_SLIP * sensitivity:
        filter_.gate[state.DISAGREEMENT] = 0.0
        # Both radii are equally likely to have changed.
        variance = min(_SLIP_GROWTH * squared / sensitivity, MAX_SLIP * MAX_SLIP)
        filter_.P[3, 3] += variance
        filter_.P[4, 4] += variance


def average(filter_: FilterState, options: Options) -> tuple[Array, Array]:
    """Return mean (n,) and covariance (n, n) over two hypotheses on the errors of a sensor: as configured, or not.

    Estimating an error that does not exist costs accuracy. The user gives the prior probability that the wheels are as
    configured; for the landmark sensor both hypotheses are equally likely. The filter runs under the second hypothesis.
    Its estimate conditioned on the configured errors is the estimate under the first one. The ratio of the present to
    the initial density at these errors is the Bayes factor of the first hypothesis (Savage-Dickey density ratio).
    """
    x, P = filter_.x.copy(), filter_.P.copy()
    if options.size > WHEELS:
        _average_over(x, P, options, WHEELS, options.wheels_as_configured)
    if options.size > SENSOR:
        _average_over(x, P, options, SENSOR, _EVEN)
    return x, P


def _average_over(x: Array, P: Array, options: Options, first: int, prior: float) -> None:
    """Average in place over both hypotheses on the three errors from index ``first`` on."""
    given, P_given, log_ratio = x, P, 0.0
    for at in range(first, first + 3):
        variance, at_start = float(P_given[at, at]), options.variances[at - WHEELS]
        if at_start > 0.0 and variance > 0.0:
            shift = options.errors[at - WHEELS] - float(given[at])
            log_ratio += 0.5 * (math.log(at_start / variance) - shift * shift / variance)
            given, P_given = kalman.condition(given, P_given, at, options.errors[at - WHEELS])
    # Probability of the first hypothesis; the logarithm is bounded so that exp does not overflow.
    likely = prior / (prior + (1.0 - prior) * math.exp(min(-log_ratio, 700.0)))
    between = given - x
    P += likely * (P_given - P) + likely * (1.0 - likely) * between * between.reshape(len(between), 1)
    x += likely * between
    x[2] = wrap_angle(float(x[2]))
