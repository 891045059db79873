"""How long the errors of landmarks last, found from their measurements: pure functions with their memory.

The same two numbers show it as for fixes (:mod:`fix_correlation`), here from neighbouring measurements of one landmark:
the difference of their innovations, less what corrections moved the estimate by between them, and their product. All
landmarks share the answer, since one sensor measures them: an error is exp(-dt / time) of what it was a time dt before.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

from diffbot_control.filter.correlation import inflation_after
from diffbot_control.filter.fix_correlation import MAX_SQUARE, MEMORY, STANDING, Travelled, correlation_of
from diffbot_control.filter.measurements import Array, Source
from diffbot_core.geometry import Pose, wrap_angle
from diffbot_core.units import S_PER_NS

_MAX_MOTION = 1.0
"""Variance that the motion between two measurements may have in terms of R: beyond, their difference says nothing."""


class Pair(NamedTuple):
    """Two neighbouring measurements of one landmark, as means over their numbers."""

    difference: float
    """half the squared difference of the innovations over R; 1 - c is expected, and the motion's part"""
    motion: float
    """the motion's part"""
    product: float
    """of the innovations over R; c is expected of a filter that follows none of the errors"""
    square: float
    """of the innovations over R; 1 is expected of such a filter"""
    numbers: int
    """that each measured"""
    dt: float
    """[s] between them"""


class CorrelationMeans(NamedTuple):
    """Slow means over the pairs of all landmarks, see :class:`Pair`."""

    difference: float
    motion: float
    product: float
    square: float
    dt: float
    """[s]"""
    pairs: int
    """number of pairs so far, up to those remembered"""
    time: float
    """[s] how long errors last; 0: independent"""


NO_PAIRS = CorrelationMeans(1.0, 0.0, 0.0, 1.0, 0.0, 0, 0.0)


class Seen(NamedTuple):
    """The newest measurement of a landmark, and the filter before its correction."""

    stamp: int
    """[ns]"""
    innovation: Array
    """(m,)"""
    pose: Pose
    var_theta: float
    """[rad^2]"""
    shift: Array
    """(n,) sum of the corrections of the state so far"""
    travelled: Travelled
    """since the start"""


class LandmarkCorrelation(NamedTuple):
    """Memory of the search for correlated errors of landmarks."""

    means: CorrelationMeans
    seen: Mapping[Source, Seen]
    """newest measurement of each landmark; never changed in place"""
    shift: Any
    """(n,) sum of the corrections of the state so far; 0.0 before the first"""
    travelled: Travelled
    """since the start"""


def new_landmark_correlation() -> LandmarkCorrelation:
    """Return the memory before the first measurement: independent errors."""
    return LandmarkCorrelation(NO_PAIRS, {}, 0.0, STANDING)


def unseen(memory: LandmarkCorrelation) -> LandmarkCorrelation:
    """Return the memory after a jump of the estimate: no landmark has a partner, what was found stays."""
    return LandmarkCorrelation(memory.means, {}, 0.0, STANDING)


def compared(y: Array, before: Array, H: Array, R: Array, shift: Array, spread: tuple[float, float], dt: float) -> Pair:
    """Compare an innovation with the one before of the same landmark.

    Args:
        y: innovation (m,).
        before: the one before (m,).
        H: derivative of the measurement by the state (m, n).
        R: its covariance (m, m).
        shift: by what corrections have moved the state between them (n,).
        spread: variance that the motion between them has added to each coordinate [m^2] and to the heading [rad^2].
        dt: time between them [s].
    """
    difference, motion, product, square, size = 0.0, 0.0, 0.0, 0.0, len(before)
    for i in range(size):
        newest = y[i] - before[i]
        for j in range(len(shift)):
            newest += H[i, j] * shift[j]
        moved = (H[i, 0] * H[i, 0] + H[i, 1] * H[i, 1]) * spread[0] + H[i, 2] * H[i, 2] * spread[1]
        weight = 1.0 / (R[i, i] * size)
        difference += 0.5 * newest * newest * weight
        motion += 0.5 * moved * weight
        product += y[i] * before[i] * weight
        square += y[i] * y[i] * weight
    return Pair(float(difference), float(motion), float(product), float(square), size, dt)


def spread_of(before: Travelled, after: Travelled, moved: tuple[float, float], var_theta: float) -> tuple[float, float]:
    """Return what a motion adds to the variance of each coordinate [m^2] and of the heading [rad^2].

    Args:
        before: at its start.
        after: at its end.
        moved: by it [m].
        var_theta: of the heading at its start [rad^2], an error of which moves its end across.
    """
    across = (moved[0] * moved[0] + moved[1] * moved[1]) * var_theta
    return after.along - before.along + across, after.turn - before.turn


def with_pair(means: CorrelationMeans, pair: Pair) -> CorrelationMeans:
    """Update the means with a pair; an outlier, or a measurement after a long way, has no partner."""
    if pair.difference >= MAX_SQUARE or pair.motion >= _MAX_MOTION or pair.dt <= 0.0:
        return means
    pairs = min(means.pairs + 1, MEMORY)
    share = 1.0 / pairs
    difference = means.difference + share * (pair.difference - means.difference)
    motion = means.motion + share * (pair.motion - means.motion)
    product = means.product + share * (pair.product - means.product)
    square = means.square + share * (pair.square - means.square)
    dt = means.dt + share * (pair.dt - means.dt)
    c = correlation_of(difference, motion, product, pair.numbers * pairs)
    return CorrelationMeans(difference, motion, product, square, dt, pairs, -dt / math.log(c) if c > 0.0 else 0.0)


def inflation_by(means: CorrelationMeans, dt: float) -> float:
    """Return the factor on R of a measurement ``dt`` [s] after the one before of the same landmark.

    An R that is larger than what the innovations show covers a part of the correlation already.
    """
    if means.time == 0.0:
        return 1.0
    return max(min(means.square, 1.0) * inflation_after(dt, means.time), 1.0)


def growth_of_landmarks(before: CorrelationMeans, after: CorrelationMeans) -> float:
    """Factor on the pose's part of P: it was computed with too small an R if errors are found to last longer."""
    return max(inflation_by(after, after.dt) / inflation_by(before, after.dt), 1.0)


def with_landmark(memory: LandmarkCorrelation, source: Source, now: Seen, H: Array, R: Array) -> LandmarkCorrelation:
    """Update the memory with an accepted measurement of a landmark; ``H`` and ``R`` as of :func:`compared`."""
    means, last = memory.means, memory.seen.get(source)
    if last is not None and last.innovation.size == now.innovation.size:
        shift = now.shift - last.shift
        moved = now.pose.x - last.pose.x - shift.item(0), now.pose.y - last.pose.y - shift.item(1)
        spread = spread_of(last.travelled, now.travelled, moved, last.var_theta)
        dt = (now.stamp - last.stamp) * S_PER_NS
        means = with_pair(means, compared(now.innovation, last.innovation, H, R, shift, spread, dt))
    return memory._replace(means=means, seen={**memory.seen, source: now})


def with_shift(memory: LandmarkCorrelation, before: Array, after: Array) -> LandmarkCorrelation:
    """Add a correction of the state from ``before`` to ``after`` (n,)."""
    if not memory.seen:
        return memory
    shift = after - before
    shift[2] = wrap_angle(shift.item(2))
    return memory._replace(shift=memory.shift + shift)
