"""The filter with its gate, its way back and its adaptation, as pure functions of floats for compiled campaigns.

What :mod:`diffbot_control.filter.gated_filter` does with filterpy's matrices is done here with the numbers of
:mod:`diffbot_sim.compiled.scalar_ekf`; the decisions are the same functions. A test holds both together.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from diffbot_control.filter.adaptation import Adaptation, adapted, new_adaptation, q_scale, r_scales, rescaled
from diffbot_control.filter.gate import (
    ACCEPTED,
    RELOCATED,
    Doubt,
    FixGate,
    despaired,
    doubted,
    doubting,
    judged,
    passed,
)
from diffbot_control.filter.options import FilterOptions
from diffbot_core.geometry import wrap_angle
from diffbot_core.kinematics import Twist
from diffbot_sim.compiled.scalar_ekf import (
    Belief,
    Fix,
    Sighting,
    lost,
    predict,
    scaled,
    started,
    unknown,
    update_heading,
    update_landmark,
    update_pose,
    wheels_checked,
)


class Track(NamedTuple):
    """All that the filter remembers."""

    belief: Belief
    known: bool
    """False before the first fix"""
    candidate: Belief
    """of the rejected fixes, if there are any in ``gate``"""
    gate: FixGate
    doubt: Doubt
    adaptation: Adaptation
    nis: float
    """of the newest measurement"""
    verdict: int
    """on the newest fix"""


def new_track(options: FilterOptions) -> Track:
    """Nothing is known yet."""
    belief = unknown(options.radius_variance)
    return Track(belief, False, belief, FixGate(0, 0, 0.0, 0.0), Doubt(0, 0.0), new_adaptation(), math.nan, ACCEPTED)


def move(
    track: Track, twist: Twist, dt: float, noise: tuple[float, float, float], separation: float, options: FilterOptions
) -> Track:
    """Predict over ``dt`` [s]; arguments as of :func:`diffbot_sim.compiled.scalar_ekf.predict`."""
    if options.adaptive:
        q = q_scale(track.adaptation)
        noise = (q * noise[0], q * noise[1], q * noise[2])
    belief = predict(track.belief, twist, dt, noise, separation, options.radius_walk)
    candidate = track.candidate
    if track.gate.rejected > 0:
        candidate = predict(candidate, twist, dt, noise, separation, options.radius_walk)
    gate, doubt = passed(track.gate, dt), doubted(track.doubt, dt)
    return Track(belief, True, candidate, gate, doubt, track.adaptation, track.nis, track.verdict)


def take_fix(track: Track, fix: Fix, options: FilterOptions) -> Track:
    """Start with, or correct with, a fix."""
    adaptation = track.adaptation
    if not track.known:
        belief = started(fix, track.belief)
        no_gate = FixGate(0, 0, 0.0, 0.0)
        return Track(belief, True, belief, no_gate, Doubt(0, 0.0), adaptation, math.nan, ACCEPTED)
    if options.adaptive:
        position, heading = r_scales(adaptation)
        fix = Fix(fix.pose, position * fix.var_x, position * fix.var_y, heading * fix.var_theta)
    bound = math.exp(track.gate.slack) * options.gates[2]
    after = update_pose(track.belief, fix)
    expected = 0.0 <= after.nis <= bound
    if options.adaptive:
        P, pose = track.belief.P, track.belief.pose
        s_x, s_y, s_theta = P.xx + fix.var_x, P.yy + fix.var_y, P.tt + fix.var_theta
        if min(s_x, s_y, s_theta) > 0.0 and not math.isnan(after.nis):
            adaptation = adapted(
                adaptation,
                (fix.pose.x - pose.x) / math.sqrt(s_x),
                (fix.pose.y - pose.y) / math.sqrt(s_y),
                wrap_angle(fix.pose.theta - pose.theta) / math.sqrt(s_theta),
                expected,
            )
    candidate, agrees = track.candidate, False
    if not expected:
        # The candidate is new where there is none, and where the fix does not agree with it.
        renewed = started(fix, track.belief)
        if track.gate.rejected > 0:
            other = update_pose(candidate, fix)
            agrees = 0.0 <= other.nis <= bound
            candidate = _checked(other.belief, options) if agrees else renewed
        else:
            candidate = renewed
    gate, verdict = judged(track.gate, expected, agrees, options)
    belief, doubt = track.belief, Doubt(0, 0.0)
    if verdict == ACCEPTED:
        belief = _checked(after.belief, options)
    elif verdict == RELOCATED:
        belief = candidate
    else:
        doubt = track.doubt
    if options.adaptive:
        factor = rescaled(track.adaptation, adaptation)
        belief, candidate = scaled(belief, factor), scaled(candidate, factor)
    return Track(belief, True, candidate, gate, doubt, adaptation, after.nis, verdict)


def take_heading(track: Track, heading: float, variance: float, options: FilterOptions) -> Track:
    """Correct with a heading [rad]."""
    after = update_heading(track.belief, heading, variance)
    if 0.0 <= after.nis <= options.gates[0]:
        return _with_other(track, _checked(after.belief, options), after.nis)
    if not despaired(doubting(track.doubt), options):
        return _doubtful(track, after.nis)
    again = update_heading(lost(track.belief), heading, variance)
    return _with_other(track, _checked(again.belief, options), after.nis)


def take_landmark(track: Track, seen: Sighting, options: FilterOptions) -> Track:
    """Correct with range and bearing of a known point."""
    after = update_landmark(track.belief, seen)
    if after.nis == math.inf:  # the robot stands at it
        return track
    if 0.0 <= after.nis <= options.gates[1]:
        return _with_other(track, _checked(after.belief, options), after.nis)
    if not despaired(doubting(track.doubt), options):
        return _doubtful(track, after.nis)
    again = update_landmark(lost(track.belief), seen)
    return _with_other(track, _checked(again.belief, options), after.nis)


def _with_other(track: Track, belief: Belief, nis: float) -> Track:
    doubt = Doubt(0, 0.0)
    return Track(belief, True, track.candidate, track.gate, doubt, track.adaptation, nis, track.verdict)


def _doubtful(track: Track, nis: float) -> Track:
    doubt = doubting(track.doubt)
    return Track(track.belief, True, track.candidate, track.gate, doubt, track.adaptation, nis, track.verdict)


def _checked(belief: Belief, options: FilterOptions) -> Belief:
    return wheels_checked(belief, options.radius_most, options.radius_variance)
