"""The filter with its gate, its relocation and its adaptation, for compiled campaigns.

The counterpart of :mod:`diffbot_control.filter.gated_filter`: models, gate and adaptation are the same functions, the
algebra is that of :mod:`diffbot_sim.compiled.ekf` instead of filterpy's. A test holds both together.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from diffbot_control.filter.adaptation import (
    Adaptation,
    Normalised,
    adapt,
    inflation,
    new_adaptation,
    q_scale,
    r_scales,
)
from diffbot_control.filter.averaging import EVEN, landmark_variances, wheel_variances
from diffbot_control.filter.dock import FixNoise, scaled_noise
from diffbot_control.filter.fix_correlation import (
    STANDING,
    FixCorrelation,
    Travelled,
    Variances,
    growth,
    new_fix_correlation,
    travel,
    unpaired,
    with_fix,
)
from diffbot_control.filter.gate import (
    ACCEPTED,
    RELOCATED,
    RESET_VAR_THETA,
    RESET_VAR_XY,
    WEIGHED,
    Decision,
    GateMemory,
    age,
    decide_fix,
    decide_other,
    decide_weight,
    fix_bound,
    is_expected,
    new_gate,
)
from diffbot_control.filter.landmark_correlation import (
    NO_PAIRS,
    CorrelationMeans,
    compared,
    growth_of_landmarks,
    inflation_by,
    spread_of,
    with_pair,
)
from diffbot_control.filter.models import Motion, pose_innovation, slip_covariance
from diffbot_control.filter.options import FilterOptions
from diffbot_control.filter.slip import add_innovation
from diffbot_core.errors import InvalidValueError
from diffbot_core.geometry import Point, Pose, wrap_angle
from diffbot_core.kinematics import TwistCovariance, scale_twist_covariance
from diffbot_sim.compiled.ekf import (
    GYRO,
    LANDMARKS,
    POSE,
    WHEELS,
    average_over,
    belief_type,
    copy_to,
    correct,
    fill_fix,
    fill_heading,
    fill_landmark,
    fill_rate,
    inflate,
    normalise,
    pose_of,
    predict,
    reset_to,
    work_type,
)


class PoseFix(NamedTuple):
    """A measured pose."""

    pose: Pose
    noise: FixNoise


class LandmarkMeasurement(NamedTuple):
    """Range and bearing of a known landmark, with independent errors."""

    range: float
    """[m]"""
    bearing: float
    """[rad] in the robot's frame"""
    landmark: Point
    """its position [m]"""
    var_range: float
    """[m^2]"""
    var_bearing: float
    """[rad^2]"""


class Newest(NamedTuple):
    """Results of the newest measurements."""

    nis: float
    """of the newest measurement; nan before the first"""
    fix_outcome: int
    """of the gate's decision on the newest fix"""


class Track(NamedTuple):
    """State of the filter but for its arrays, see :func:`filter_type`."""

    initialised: bool
    """False before the first fix"""
    gate: GateMemory
    adaptation: Adaptation
    newest: Newest
    fix_correlation: FixCorrelation
    """of the fixes, where it is to be found"""
    travelled: Travelled
    """since the newest fix"""
    landmarks: CorrelationMeans
    """of the landmarks, where the correlation of their errors is to be found"""
    disagreement: float
    """mean of :class:`slip.Disagreement`"""


def kept_type(n: int) -> Any:
    """Return the type of a record with what a state of the filter keeps in arrays, for ``n`` states.

    The candidate is the hypothesis of the rejected fixes, without a meaning if there are none. Shift is the sum of the
    corrections of the state, along [m^2] and turn [rad^2] the variances that the motion has added: both since the
    start. The era is another one after each jump of the estimate.
    """
    corrections = [("shift", float, (n,)), ("along", float), ("turn", float), ("era", np.int64)]
    return np.dtype([("belief", belief_type(n)), ("candidate", belief_type(n)), *corrections])


def filter_type(n: int) -> Any:
    """Return the type of the filter's arrays for ``n`` states: :func:`kept_type`, what is reported, and its work."""
    working = [("reported", belief_type(n)), ("given", belief_type(n)), ("work", work_type(n))]
    return np.dtype([*kept_type(n).descr, *working])


def seen_type(n: int) -> Any:
    """Return the type of the newest measurement of a landmark: :class:`landmark_correlation.Seen` in an era."""
    numbers = [("time", float), ("x", float), ("y", float), ("var_theta", float), ("along", float), ("turn", float)]
    return np.dtype([("era", np.int64), ("innovation", float, (2,)), ("shift", float, (n,)), *numbers])


def copy_kept(target: Any, source: Any) -> None:
    """Overwrite what a record keeps, see :func:`kept_type`, with that of another one."""
    copy_to(target["belief"], source["belief"])
    copy_to(target["candidate"], source["candidate"])
    for i in range(len(source["shift"])):
        target["shift"][i] = source["shift"][i]
    target["along"], target["turn"], target["era"] = source["along"], source["turn"], source["era"]


def check_supported(options: FilterOptions) -> None:
    """Refuse options that only the filter of the node has.

    Raises:
        InvalidValueError: for errors that are correlated over a given time.
    """
    if any(options.correlation_times):
        raise InvalidValueError("correlation times", options.correlation_times, "0 in a batch")


def new_track() -> Track:
    """Return the state before the first fix."""
    newest = Newest(math.nan, ACCEPTED)
    return Track(False, new_gate(), new_adaptation(), newest, new_fix_correlation(), STANDING, NO_PAIRS, 0.0)


def reset_arrays(arrays: Any, options: FilterOptions) -> None:
    """Forget everything before the first fix: known errors with their initial variances."""
    x, P = arrays["belief"]["x"], arrays["belief"]["P"]
    for i in range(len(x)):
        x[i] = 0.0
        for j in range(len(x)):
            P[i, j] = 0.0
    _reset_wheels(arrays["belief"], options)
    if len(x) > WHEELS:
        for i in range(3):
            x[WHEELS + i] = options.landmark_errors[i]
            P[WHEELS + i, WHEELS + i] = options.landmark_sigmas[i] ** 2
        P[LANDMARKS, LANDMARKS] = options.gyro_bias_variance


def advance(track: Track, arrays: Any, motion: Motion, separation: float, options: FilterOptions) -> Track:
    """Predict; ``separation`` is the distance of the wheels [m]."""
    belief, candidate, work = arrays["belief"], arrays["candidate"], arrays["work"]
    walks, travelled = (options.radius_random_walk, options.gyro_bias_random_walk), track.travelled
    if options.adaptive:
        covariance = scale_twist_covariance(motion.covariance, q_scale(track.adaptation))
        motion = Motion(motion.twist, motion.dt, covariance, motion.rate)
    predict(belief, work, motion, 0.0, separation, walks[0], walks[1])
    if track.gate.fixes.rejected > 0:
        predict(candidate, work, motion, 0.0, separation, walks[0], walks[1])
    if options.detects_fix_correlation:
        travelled = travel(travelled, motion, 0.0)
    if options.detects_landmark_correlation:
        total = travel(Travelled(arrays["along"], arrays["turn"]), motion, 0.0)
        arrays["along"], arrays["turn"] = total.along, total.turn
    gate = age(track.gate, motion.dt)
    newest, landmarks = track.newest, track.landmarks
    return Track(True, gate, track.adaptation, newest, track.fix_correlation, travelled, landmarks, track.disagreement)


def reported_belief(arrays: Any, options: FilterOptions) -> Any:
    """Return the belief averaged over both hypotheses, see :mod:`averaging`; the next call overwrites it."""
    wheels, landmarks = wheel_variances(options), landmark_variances(options)
    reported, given = arrays["reported"], arrays["given"]
    copy_to(reported, arrays["belief"])
    if max(wheels) > 0.0:
        average_over(reported, given, POSE, options.wheel_errors, wheels, options.wheels_as_configured)
    if max(landmarks) > 0.0:
        average_over(reported, given, WHEELS, options.landmark_errors, landmarks, EVEN)
    return reported


def take_rate(
    track: Track, arrays: Any, motion: Motion, separation: float, options: FilterOptions
) -> tuple[Track, TwistCovariance]:
    """Correct the errors of wheels and gyro with a turn rate; return what its contradiction adds to the covariance.

    The counterpart of what :class:`diffbot_control.filter.localization.Localization` does with a turn rate.
    """
    none = TwistCovariance(0.0, 0.0, 0.0)
    belief, work = arrays["belief"], arrays["work"]
    if motion.rate.variance == math.inf or len(belief["x"]) < GYRO:
        return track, none
    m = fill_rate(belief, work, motion, separation)
    difference, nis = work["y"][0], normalise(belief, work, m, POSE).nis
    beyond = nis > options.gates[0]
    S, by, mean = work["S"][0, 0] + work["R"][0, 0], (work["H"][0, 3], work["H"][0, 4]), track.disagreement
    _correct(arrays, m, 1.0, nis / options.gates[0] if beyond else 1.0, options)
    if options.radius_variance > 0.0 and not beyond:
        mean, variance = add_innovation(mean, difference, S, motion.dt, by)
        belief["P"][3, 3] += variance
        belief["P"][4, 4] += variance
    fixes, landmarks, travelled = track.fix_correlation, track.landmarks, track.travelled
    track = Track(True, track.gate, track.adaptation, track.newest, fixes, travelled, landmarks, mean)
    return track, slip_covariance(difference, separation) if beyond else none


def initialise(track: Track, arrays: Any, fix: PoseFix) -> Track:
    """Put the filter at a fix; errors of the wheels and adaptation stay."""
    belief, work = arrays["belief"], arrays["work"]
    fill_fix(belief, work, fix.pose)
    _put_noise(work, fix)
    reset_to(belief, fix.pose, work["R"])
    arrays["era"] += 1
    newest, found = Newest(math.nan, ACCEPTED), unpaired(track.fix_correlation)
    return Track(True, new_gate(), track.adaptation, newest, found, STANDING, track.landmarks, 0.0)


def take_fix(track: Track, arrays: Any, fix: PoseFix, options: FilterOptions) -> Track:
    """Initialise with a fix, or correct with it as the gate decides."""
    if not track.initialised:
        return initialise(track, arrays, fix)
    belief, candidate, work = arrays["belief"], arrays["candidate"], arrays["work"]
    adaptation = track.adaptation
    if options.adaptive:
        position, heading = r_scales(adaptation)
        fix = PoseFix(fix.pose, scaled_noise(fix.noise, position, heading))
    before, P = pose_of(belief), belief["P"]
    variances = Variances(P[0, 0] + fix.noise.xx, P[1, 1] + fix.noise.yy, P[2, 2] + fix.noise.tt)
    nis, candidate_nis = _normalised(belief, work, fix), math.nan
    if track.gate.fixes.rejected > 0 and not is_expected(nis, fix_bound(track.gate, options.gates[2])):
        candidate_nis = _normalised(candidate, work, fix)
    gate, decision = decide_fix(track.gate, nis, candidate_nis, options.gates[2], options)
    _apply(arrays, fix, decision, track.fix_correlation.inflation, options)
    if options.adaptive:
        adaptation = _adapted(adaptation, before, fix, variances, nis, decision.outcome == ACCEPTED)
        factor = inflation(track.adaptation, adaptation)
        inflate(belief, factor)
        inflate(candidate, factor)
    fix_correlation = track.fix_correlation
    if options.detects_fix_correlation:
        fix_correlation = _with_fix(track, belief, fix, before, decision.outcome == ACCEPTED)
    newest = Newest(nis, decision.outcome)
    return Track(True, gate, adaptation, newest, fix_correlation, STANDING, track.landmarks, track.disagreement)


def _put_noise(work: Any, fix: PoseFix) -> None:
    R = work["R"]
    R[0, 0], R[1, 1], R[2, 2] = fix.noise.xx, fix.noise.yy, fix.noise.tt
    R[0, 1] = R[1, 0] = fix.noise.xy
    R[0, 2] = R[2, 0] = fix.noise.xt
    R[1, 2] = R[2, 1] = fix.noise.yt


def _normalised(belief: Any, work: Any, fix: PoseFix) -> float:
    """Return the NIS of a fix."""
    m = fill_fix(belief, work, fix.pose)
    _put_noise(work, fix)
    return normalise(belief, work, m).nis


def _apply(arrays: Any, fix: PoseFix, decision: Decision, inflation: float, options: FilterOptions) -> None:
    """Correct estimate or candidate with the fix that was normalised for it last, with R times ``inflation``."""
    belief, candidate, work = arrays["belief"], arrays["candidate"], arrays["work"]
    if decision.outcome == ACCEPTED:
        _correct(arrays, POSE, inflation, 1.0, options)
        return
    if decision.agrees:
        correct(candidate, work, POSE, inflation, 1.0)
        _reset_impossible(candidate, options)
    else:
        copy_to(candidate, belief)
        reset_to(candidate, fix.pose, work["R"])
    if decision.outcome == RELOCATED:
        copy_to(belief, candidate)
        arrays["era"] += 1


def _correct(arrays: Any, m: int, inflation: float, weaker: float, options: FilterOptions) -> None:
    """Correct the estimate as :func:`ekf.correct` does, and count by what it was shifted."""
    belief, shift = arrays["belief"], arrays["shift"]
    x = belief["x"]
    theta = x[2]
    if options.detects_landmark_correlation:
        for i in range(len(x)):
            shift[i] -= x[i]
    correct(belief, arrays["work"], m, inflation, weaker)
    _reset_impossible(belief, options)
    if options.detects_landmark_correlation:
        for i in range(len(x)):
            shift[i] += x[i]
        turned = x[2] - theta
        shift[2] += wrap_angle(turned) - turned


def _with_fix(track: Track, belief: Any, fix: PoseFix, before: Pose, accepted: bool) -> FixCorrelation:
    """Return what a fix says about the correlation of the errors of fixes, and inflate the belief by it."""
    if not accepted:
        return unpaired(track.fix_correlation)
    R = Variances(fix.noise.xx, fix.noise.yy, fix.noise.tt)
    fix_correlation = with_fix(
        track.fix_correlation, track.travelled, fix.pose, R, before, pose_of(belief), belief["P"][2, 2]
    )
    inflate(belief, growth(track.fix_correlation, fix_correlation))
    return fix_correlation


def _adapted(
    adaptation: Adaptation, before: Pose, fix: PoseFix, variances: Variances, nis: float, expected: bool
) -> Adaptation:
    """Adapt to the innovation of a fix against ``before``, of these ``variances``."""
    if min(variances.x, variances.y, variances.theta) <= 0.0 or math.isnan(nis):
        return adaptation
    x, y, theta = pose_innovation(fix.pose, before)
    s_x, s_y, s_theta = math.sqrt(variances.x), math.sqrt(variances.y), math.sqrt(variances.theta)
    return adapt(adaptation, Normalised(x / s_x, y / s_y, theta / s_theta), expected)


def take_heading(track: Track, arrays: Any, heading: float, variance: float, options: FilterOptions) -> Track:
    """Correct with a heading [rad] of this variance [rad^2] as the gate decides."""
    belief, work = arrays["belief"], arrays["work"]
    m = fill_heading(belief, work, heading, variance)
    nis = normalise(belief, work, m).nis
    gate, decision = decide_other(track.gate, nis, options.gates[0], options)
    if decision.outcome == RELOCATED:
        _reset_pose(belief, work)
        normalise(belief, work, fill_heading(belief, work, heading, variance))
    if decision.outcome in (ACCEPTED, RELOCATED):
        _correct(arrays, m, 1.0, 1.0, options)
    if decision.outcome == RELOCATED:
        arrays["era"] += 1
    return _with_other(track, gate, nis, track.landmarks)


def take_landmark(
    track: Track, arrays: Any, seen: Any, measured: LandmarkMeasurement, time: float, options: FilterOptions
) -> Track:
    """Correct with range and bearing of a known landmark as the gate decides.

    Args:
        track: state of the filter.
        arrays: of the filter, changed in place.
        seen: record of the landmark's newest measurement, see :func:`seen_type`, which this one replaces.
        measured: range and bearing.
        time: of the measurement [s].
        options: of the filter.
    """
    belief, work, nis = arrays["belief"], arrays["work"], math.inf
    means, inflation = track.landmarks, 1.0
    m = _fill_landmark(belief, work, measured)
    if m > 0:
        nis = normalise(belief, work, m).nis
    bound, weaker = options.gates[1], 1.0
    if options.weigh_landmarks:
        gate, decision = decide_weight(track.gate, nis, bound)
        weaker = nis / bound if decision.outcome == WEIGHED else 1.0
    else:
        gate, decision = decide_other(track.gate, nis, bound, options)
    if options.detects_landmark_correlation and m > 0:
        if seen["era"] == arrays["era"]:
            inflation = inflation_by(means, time - seen["time"])
        if decision.outcome == ACCEPTED:
            means = _with_landmark(means, arrays, seen, time)
    if decision.outcome == RELOCATED:
        _reset_pose(belief, work)
        normalise(belief, work, _fill_landmark(belief, work, measured))
    if decision.outcome in (ACCEPTED, RELOCATED, WEIGHED):
        _correct(arrays, m, inflation, weaker, options)
    if decision.outcome == RELOCATED:
        arrays["era"] += 1
    inflate(belief, growth_of_landmarks(track.landmarks, means))
    return _with_other(track, gate, nis, means)


def _with_landmark(means: CorrelationMeans, arrays: Any, seen: Any, time: float) -> CorrelationMeans:
    """Return what the landmark that was filled in says about the correlation of errors, and remember it as seen."""
    belief, work, shift = arrays["belief"], arrays["work"], seen["shift"]
    x, total = belief["x"], Travelled(arrays["along"], arrays["turn"])
    if seen["era"] == arrays["era"]:
        for i in range(len(shift)):
            shift[i] = arrays["shift"][i] - shift[i]
        moved = x[0] - seen["x"] - shift[0], x[1] - seen["y"] - shift[1]
        spread = spread_of(Travelled(seen["along"], seen["turn"]), total, moved, seen["var_theta"])
        pair = compared(work["y"], seen["innovation"], work["H"], work["R"], shift, spread, time - seen["time"])
        means = with_pair(means, pair)
    seen["era"], seen["time"] = arrays["era"], time
    seen["x"], seen["y"], seen["var_theta"] = x[0], x[1], belief["P"][2, 2]
    seen["along"], seen["turn"] = total.along, total.turn
    for i in range(2):
        seen["innovation"][i] = work["y"][i]
    for i in range(len(shift)):
        shift[i] = arrays["shift"][i]
    return means


def _fill_landmark(belief: Any, work: Any, measured: LandmarkMeasurement) -> int:
    variances = measured.var_range, measured.var_bearing
    return fill_landmark(belief, work, measured.range, measured.bearing, variances, measured.landmark)


def _reset_pose(belief: Any, work: Any) -> None:
    """Make the pose nearly unknown at the same mean; the errors of the wheels stay."""
    R = work["R"]
    R[0, 1] = R[1, 0] = R[0, 2] = R[2, 0] = R[1, 2] = R[2, 1] = 0.0
    R[0, 0] = R[1, 1] = RESET_VAR_XY
    R[2, 2] = RESET_VAR_THETA
    reset_to(belief, pose_of(belief), R)


def _with_other(track: Track, gate: GateMemory, nis: float, landmarks: CorrelationMeans) -> Track:
    """Return the track after a measurement that was no fix."""
    newest, fixes, travelled = Newest(nis, track.newest.fix_outcome), track.fix_correlation, track.travelled
    return Track(True, gate, track.adaptation, newest, fixes, travelled, landmarks, track.disagreement)


def _reset_wheels(belief: Any, options: FilterOptions) -> None:
    """Put the errors of the wheels at their initial values, uncorrelated with all else."""
    x, P = belief["x"], belief["P"]
    for i in range(POSE, WHEELS):
        for j in range(len(x)):
            P[i, j] = P[j, i] = 0.0
        P[i, i] = options.radius_variance if i < WHEELS - 1 else options.separation_variance
        x[i] = options.wheel_errors[i - POSE] if P[i, i] > 0.0 else 0.0


def _reset_impossible(belief: Any, options: FilterOptions) -> None:
    """Reset the errors of the wheels if one is beyond its bound."""
    x, start = belief["x"], options.wheel_errors
    radii = max(abs(x[3] - start[0]), abs(x[4] - start[1]))
    separation = abs(x[5] - start[2]) if options.separation_variance > 0.0 else 0.0
    if radii > options.max_radius_error or separation > options.max_separation_error:
        _reset_wheels(belief, options)
