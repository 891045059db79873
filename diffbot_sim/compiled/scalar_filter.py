"""The filter with its gate, its relocation and its adaptation, as pure functions of floats for compiled campaigns.

The counterpart of :mod:`diffbot_control.filter.gated_filter`: models, gate and adaptation are the same functions, the
algebra is that of :mod:`diffbot_sim.compiled.scalar_ekf` instead of filterpy's. A test holds both together.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from diffbot_control.filter.adaptation import (
    Adaptation,
    Normalised,
    adapt,
    inflation,
    new_adaptation,
    q_scale,
    r_scales,
)
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
    Decision,
    GateMemory,
    age,
    decide_fix,
    decide_other,
    fix_bound,
    is_expected,
    new_gate,
)
from diffbot_control.filter.models import Motion, pose_innovation
from diffbot_control.filter.options import REJECT, WEIGH, FilterOptions
from diffbot_core.errors import InvalidValueError
from diffbot_core.kinematics import scale_twist_covariance
from diffbot_sim.compiled.scalar_belief import (
    Belief,
    PoseFix,
    inflate,
    reset_pose,
    reset_to,
    unknown,
    with_possible_wheels,
)
from diffbot_sim.compiled.scalar_ekf import (
    Corrected,
    LandmarkMeasurement,
    predict,
    update_heading,
    update_landmark,
    update_pose,
)


class Newest(NamedTuple):
    """Results of the newest measurements."""

    nis: float
    """of the newest measurement; nan before the first"""
    fix_outcome: int
    """of the gate's decision on the newest fix"""


class Track(NamedTuple):
    """State of the filter."""

    initialised: bool
    """False before the first fix"""
    belief: Belief
    candidate: Belief
    """hypothesis of the rejected fixes; without a meaning if there are none"""
    gate: GateMemory
    adaptation: Adaptation
    newest: Newest
    fix_correlation: FixCorrelation
    """of the fixes, where it is to be found"""
    travelled: Travelled
    """since the newest fix"""


def check_supported(options: FilterOptions) -> None:
    """Refuse options that only the filter of the node has.

    Raises:
        InvalidValueError: for calibrated wheels, weighed or calibrated landmarks, or errors correlated in time.
    """
    if any(options.wheel_errors):
        raise InvalidValueError("wheel errors at the start", options.wheel_errors, "0 in a batch")
    if options.weigh_landmarks:
        raise InvalidValueError("landmark_gate", WEIGH, f"{REJECT} in a batch")
    if options.landmark_sigmas is not None or any(options.landmark_errors):
        raise InvalidValueError("landmark_range_offset and the like", options.landmark_errors, "0 in a batch")
    if any(options.correlation_times):
        raise InvalidValueError("correlation times", options.correlation_times, "0 in a batch")


def new_track(options: FilterOptions) -> Track:
    """Return the state before the first fix."""
    belief = unknown(options.radius_variance, options.separation_variance)
    newest = Newest(math.nan, ACCEPTED)
    return Track(False, belief, belief, new_gate(), new_adaptation(), newest, new_fix_correlation(), STANDING)


def advance(track: Track, motion: Motion, separation: float, options: FilterOptions) -> Track:
    """Predict; ``separation`` is the distance of the wheels [m]."""
    if options.adaptive:
        covariance = scale_twist_covariance(motion.covariance, q_scale(track.adaptation))
        motion = Motion(motion.twist, motion.dt, covariance)
    walk = options.radius_random_walk
    walks = walk, walk if options.separation_variance > 0.0 else 0.0
    belief = predict(track.belief, motion, separation, walks)
    candidate = track.candidate
    if track.gate.fixes.rejected > 0:
        candidate = predict(candidate, motion, separation, walks)
    travelled = track.travelled
    if options.detects_fix_correlation:
        travelled = travel(travelled, motion, 0.0)
    gate = age(track.gate, motion.dt)
    return Track(True, belief, candidate, gate, track.adaptation, track.newest, track.fix_correlation, travelled)


def initialise(track: Track, fix: PoseFix) -> Track:
    """Put the filter at a fix; errors of the wheels and adaptation stay."""
    belief = reset_to(fix, track.belief)
    newest = Newest(math.nan, ACCEPTED)
    return Track(True, belief, belief, new_gate(), track.adaptation, newest, unpaired(track.fix_correlation), STANDING)


def take_fix(track: Track, fix: PoseFix, options: FilterOptions) -> Track:
    """Initialise with a fix, or correct with it as the gate decides."""
    before, old = track.belief, track.adaptation
    if not track.initialised:
        return initialise(track, fix)
    if options.adaptive:
        position, heading = r_scales(old)
        fix = PoseFix(fix.pose, position * fix.var_x, position * fix.var_y, heading * fix.var_theta)
    after = _corrected(before, fix, track.fix_correlation.inflation, options)
    other = Corrected(track.candidate, math.nan)
    if track.gate.fixes.rejected > 0 and not is_expected(after.nis, fix_bound(track.gate, options.gates[2])):
        other = _corrected(track.candidate, fix, track.fix_correlation.inflation, options)
    gate, decision = decide_fix(track.gate, after.nis, other.nis, options.gates[2], options)
    belief, candidate = _apply(track, fix, after, other, decision)
    adaptation = old
    if options.adaptive:
        adaptation = _adapted(old, before, fix, after.nis, decision.outcome == ACCEPTED)
        factor = inflation(old, adaptation)
        belief, candidate = inflate(belief, factor), inflate(candidate, factor)
    fix_correlation = track.fix_correlation
    if options.detects_fix_correlation:
        belief, fix_correlation = _with_fix_correlation(track, fix, belief, decision.outcome == ACCEPTED)
    newest = Newest(after.nis, decision.outcome)
    return Track(True, belief, candidate, gate, adaptation, newest, fix_correlation, STANDING)


def _corrected(before: Belief, fix: PoseFix, factor: float, options: FilterOptions) -> Corrected:
    """Correct with a fix and its R times ``factor``; the NIS is that of R itself."""
    after = update_pose(before, fix)
    if factor > 1.0:
        weaker = PoseFix(fix.pose, factor * fix.var_x, factor * fix.var_y, factor * fix.var_theta)
        after = Corrected(update_pose(before, weaker).belief, after.nis)
    return _possible(after, options)


def _with_fix_correlation(track: Track, fix: PoseFix, after: Belief, accepted: bool) -> tuple[Belief, FixCorrelation]:
    """Return the belief after a fix and what it says about the correlation of the errors of fixes."""
    if not accepted:
        return after, unpaired(track.fix_correlation)
    variances = Variances(fix.var_x, fix.var_y, fix.var_theta)
    before = track.belief.pose
    fix_correlation = with_fix(
        track.fix_correlation, track.travelled, fix.pose, variances, before, after.pose, after.P.tt
    )
    return inflate(after, growth(track.fix_correlation, fix_correlation)), fix_correlation


def _apply(track: Track, fix: PoseFix, after: Corrected, other: Corrected, decision: Decision) -> tuple[Belief, Belief]:
    """Return estimate and candidate after a fix."""
    if decision.outcome == ACCEPTED:
        return after.belief, track.candidate
    candidate = other.belief if decision.agrees else reset_to(fix, track.belief)
    return candidate if decision.outcome == RELOCATED else track.belief, candidate


def _adapted(adaptation: Adaptation, before: Belief, fix: PoseFix, nis: float, expected: bool) -> Adaptation:
    """Adapt to the innovation of a fix against ``before``."""
    P = before.P
    s_x, s_y, s_theta = P.xx + fix.var_x, P.yy + fix.var_y, P.tt + fix.var_theta
    if min(s_x, s_y, s_theta) <= 0.0 or math.isnan(nis):
        return adaptation
    x, y, theta = pose_innovation(fix.pose, before.pose)
    return adapt(adaptation, Normalised(x / math.sqrt(s_x), y / math.sqrt(s_y), theta / math.sqrt(s_theta)), expected)


def take_heading(track: Track, heading: float, variance: float, options: FilterOptions) -> Track:
    """Correct with a heading [rad] of this variance [rad^2] as the gate decides."""
    after = _possible(update_heading(track.belief, heading, variance), options)
    gate, decision = decide_other(track.gate, after.nis, options.gates[0], options)
    belief = track.belief
    if decision.outcome == ACCEPTED:
        belief = after.belief
    elif decision.outcome == RELOCATED:
        belief = _possible(update_heading(reset_pose(belief), heading, variance), options).belief
    return _with_other(track, belief, gate, after.nis)


def take_landmark(track: Track, measured: LandmarkMeasurement, options: FilterOptions) -> Track:
    """Correct with range and bearing of a known landmark as the gate decides."""
    after = _possible(update_landmark(track.belief, measured), options)
    gate, decision = decide_other(track.gate, after.nis, options.gates[1], options)
    belief = track.belief
    if decision.outcome == ACCEPTED:
        belief = after.belief
    elif decision.outcome == RELOCATED:
        belief = _possible(update_landmark(reset_pose(belief), measured), options).belief
    return _with_other(track, belief, gate, after.nis)


def _with_other(track: Track, belief: Belief, gate: GateMemory, nis: float) -> Track:
    newest = Newest(nis, track.newest.fix_outcome)
    return Track(True, belief, track.candidate, gate, track.adaptation, newest, track.fix_correlation, track.travelled)


def _possible(after: Corrected, options: FilterOptions) -> Corrected:
    bounds = options.max_radius_error, options.max_separation_error
    variances = options.radius_variance, options.separation_variance
    return Corrected(with_possible_wheels(after.belief, bounds, variances), after.nis)
