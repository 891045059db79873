"""Noise of the measurements of one source, estimated from the measurements: one statistic for all kinds of sources.

Assume that the errors of a source have the covariance s R, where R is the claimed one, and that each error is c times
the error before it plus an independent part. Two means over neighbouring measurements then show s and c:

- Half the squared difference of two neighbours, after the motion between them is subtracted, has the mean s (1 - c) R
  plus the variance of the odometry's motion. A drift of the estimate cancels in the difference.
- The product of two neighbouring innovations has the mean s c R, minus the part of the errors that the filter follows.
  For independent errors this mean is 0.

The row of a source also holds its mean NIS and the autocorrelation of its innovations, which show an overconfident
filter. Each row has two channels: one for positions and ranges, one for headings and bearings. All functions work on
such rows, as plain Python or compiled.
"""

from __future__ import annotations

import math
from typing import Any

from diffbot_control.filter.models import Array

DIFFERENCE, MOTION, PRODUCT, SQUARE, PAIRS, NUMBERS, SCALE = 0, 1, 2, 3, 4, 5, 6
"""Columns of a channel: slow means of half the squared difference of neighbours, of the motion's part in it, of the
product of neighbouring innovations, and of their square, all in units of R; number of pairs; number of numbers; the
factor on R."""
CHANNEL = 7
"""Number of these columns."""
PERIOD, TIME = 14, 15
"""[s] mean time between neighbours, and correlation time of the errors; 0: they are independent."""
NIS, NIS_NUMBERS, WHITENESS, WHITENESS_NUMBERS = 16, 17, 18, 19
"""Mean NIS per number, mean product of neighbouring normalised innovations, and the number of numbers in each mean."""
DRIFT = 20
"""First of three columns: slow mean of the normalised innovations of x, y, theta."""
COLUMNS = 23

_MEMORY = 200.0
"""Number of pairs that the slow means remember."""
_NIS_MEMORY, _WHITENESS_MEMORY = 150.0, 300.0
"""Number of numbers that the means of NIS and of the autocorrelation remember."""
_MAX_DIFFERENCE = 30.0
"""Half a squared difference in units of R; beyond it, one of the pair is an outlier that passed the gate."""
_MIN_DIFFERENCE = 1e-9
"""Half a squared difference in units of R; below it, the source repeats its value, which says nothing of its noise."""
_MAX_MOTION = 1.0
"""Variance of the motion between two measurements in units of R; beyond it, their difference says nothing."""
_SIGNIFICANT, _SIGNIFICANT_SCALE = 2.0, 3.0
"""[standard deviations] A larger mean product shows correlation; a larger difference from 1 shows a scale."""
_MIN_PAIRS = 10.0
"""Number of pairs from which a scale is used."""
_MAX_CORRELATION = 0.99
_MIN_DT = 1e-3
"""[s] smallest time between two measurements of one source; a smaller one counts as this time"""
_MAX_SCALE = 1e3


def clear(row: Array) -> None:
    """Initialise the row of a source."""
    row[:] = 0.0
    for channel in range(2):
        row[channel * CHANNEL + SCALE] = row[channel * CHANNEL + DIFFERENCE] = 1.0


def forget_innovations(row: Array) -> None:
    """Clear the means of NIS and autocorrelation, after the estimate was replaced."""
    row[NIS : DRIFT + 3] = 0.0


def scale_of(row: Array, angle: bool) -> float:
    """Return the factor on the variance of a number that a source claims."""
    return float(row[CHANNEL + SCALE if angle else SCALE])


def inflation_after(dt: float, time: float) -> float:
    """Return (1 + c) / (1 - c) with c = exp(-dt / time) for measurements ``dt`` [s] apart; ``time`` >= 0 [s].

    Over many measurements, correlated errors of covariance R carry as much information as independent errors of
    covariance R (1 + c) / (1 - c).
    """
    return 1.0 / math.tanh(0.5 * max(dt, _MIN_DT) / time) if time > 0.0 else 1.0


def inflation(row: Array, dt: float, time: float, landmark: bool) -> float:
    """Return the factor by which R is inflated for errors that are correlated in time.

    Args:
        row: of the source.
        dt: time since the previous measurement [s].
        time: known correlation time of the errors [s]; 0: use the one that was found.
        landmark: the measurement is of a landmark. The filter does not follow the errors of single landmarks. If their
            innovations are smaller than R claims, R already covers a part of the correlation.
    """
    if time > 0.0:
        return inflation_after(dt, time)
    shown = min(_pooled(row, SQUARE), 1.0) if landmark else 1.0
    return max(shown * inflation_after(dt, float(row[TIME])), 1.0)


def correlation_after(row: Array, time: float) -> float:
    """Return the correlation of neighbouring errors that the filter assumes; ``time`` as for :func:`inflation`."""
    lasting = time if time > 0.0 else float(row[TIME])
    return math.exp(-max(float(row[PERIOD]), _MIN_DT) / lasting) if lasting > 0.0 else 0.0


def observe(row: Array, nis: float, product: float, m: int, paired: bool) -> None:
    """Add an innovation that was accepted to the means of NIS and autocorrelation.

    Args:
        row: of the source.
        nis: of the measurement.
        product: sum over its numbers of the normalised innovation times the previous normalised innovation.
        m: number of numbers.
        paired: there is a previous measurement.
    """
    row[NIS_NUMBERS] = min(float(row[NIS_NUMBERS]) + m, _NIS_MEMORY)
    row[NIS] += m / row[NIS_NUMBERS] * (nis / m - row[NIS])
    if paired:
        row[WHITENESS_NUMBERS] = min(float(row[WHITENESS_NUMBERS]) + m, _WHITENESS_MEMORY)
        row[WHITENESS] += m / row[WHITENESS_NUMBERS] * (product / m - row[WHITENESS])


def learn(row: Array, pairs: Array, dt: float) -> None:
    """Add a pair of neighbouring measurements ``dt`` [s] apart.

    Args:
        row: of the source.
        pairs: (2, 5) array with a row for each channel: sums of DIFFERENCE, MOTION, PRODUCT, SQUARE; number of numbers.
        dt: time between both [s].
    """
    total, numbers, motion = 0.0, 0.0, 0.0
    for channel in range(2):
        numbers += float(pairs[channel, 4])
        total += float(pairs[channel, DIFFERENCE]) / float(row[channel * CHANNEL + SCALE])
        motion += float(pairs[channel, MOTION])
    if dt <= 0.0 or numbers == 0.0 or motion >= _MAX_MOTION * numbers:
        return
    if not _MIN_DIFFERENCE * numbers < total < _MAX_DIFFERENCE * numbers:
        return
    most = 0.0
    for channel in range(2):
        at, size = channel * CHANNEL, float(pairs[channel, 4])
        if size > 0.0:
            count = min(float(row[at + PAIRS]) + 1.0, _MEMORY)
            row[at + PAIRS], row[at + NUMBERS] = count, count * size
            row[at : at + 4] += (pairs[channel, :4] / size - row[at : at + 4]) / count
            most = max(most, count)
    row[PERIOD] += (dt - row[PERIOD]) / most


def _pooled(row: Array, column: int) -> float:
    """Return the mean of a column over the numbers of both channels."""
    first, second = float(row[NUMBERS]), float(row[CHANNEL + NUMBERS])
    if first + second == 0.0:
        return 1.0
    return (float(row[column]) * first + float(row[CHANNEL + column]) * second) / (first + second)


def find(row: Array) -> None:
    """Set the scale of R and the correlation time from the means.

    If a correlation is found, the scale is 1. Otherwise the scale is the mean difference, if that is significantly
    above 1. A scale below 1 is never used: an error that stays constant, such as a wrong position on the map, does not
    show in the differences, so a scale below 1 would make the filter overconfident.
    """
    c = _correlation(row)
    row[TIME] = -row[PERIOD] / math.log(c) if c > 0.0 else 0.0
    for channel in range(2):
        at, scale = channel * CHANNEL, 1.0
        pairs, numbers = float(row[at + PAIRS]), float(row[at + NUMBERS])
        if c == 0.0 and pairs >= _MIN_PAIRS:
            white = _white(float(row[at + DIFFERENCE]), float(row[at + MOTION]))
            # Half a squared difference of white noise has the variance of two; neighbouring pairs share a measurement.
            if white - 1.0 > _SIGNIFICANT_SCALE * math.sqrt(3.0 / numbers) * white:
                scale = min(white, _MAX_SCALE)
        row[at + SCALE] = scale


def _white(difference: float, motion: float) -> float:
    """Subtract the motion's part, at most half, from a mean difference: odometry is often better than it claims."""
    return max(difference - min(motion, 0.5 * difference), 1e-3)


def _correlation(row: Array) -> float:
    """Return the correlation of neighbouring errors."""
    difference, product = _pooled(row, DIFFERENCE), _pooled(row, PRODUCT)
    white = _white(difference, _pooled(row, MOTION))
    numbers = row[NUMBERS] + row[CHANNEL + NUMBERS]
    if white >= 1.0 or product <= 0.0:
        return 0.0
    # White innovations have a product of mean 0; its deviation is their variance over the root of the number.
    variance = difference + product
    if product * product * numbers <= (_SIGNIFICANT * variance) ** 2:
        return 0.0
    return min(1.0 - white, product / (product + white), _MAX_CORRELATION)


_R_RULES = (-1.0, 0.7, -0.2), (0.0, 0.7, 0.0), (1.0, 0.7, 0.2)
"""Center, width and consequent of each rule. Input: logarithm of the shown over the present scale. Output: change of
the logarithm of the scale."""
_Q_RULES = (0.0, 0.35, 0.0), (1.0, 0.35, 1.5), (2.0, 0.5, 4.0)
"""Input: drift beyond that of white innovations. Output: logarithm of the factor on Q."""
_DRIFT_SHARE = 0.1
"""Weight of the newest innovation in the drift."""


def find_fuzzy(row: Array) -> None:
    """Set the scale of R by three rules, as a fuzzy-neural filter does.

    This is a reconstruction. The paper (reference 11) names a fuzzy system that adjusts the covariances, but gives no
    equations. Here it is a zero-order Sugeno system with Gaussian memberships on the statistic of :func:`learn`.
    """
    for channel in range(2):
        part = row[channel * CHANNEL : (channel + 1) * CHANNEL]
        if part[PAIRS] > 0.0:
            shown = math.log(_white(float(part[DIFFERENCE]), float(part[MOTION])) / float(part[SCALE]))
            changed = float(part[SCALE]) * math.exp(_infer(_R_RULES, shown))
            part[SCALE] = min(max(changed, 1.0 / _MAX_SCALE), _MAX_SCALE)


def add_drift(row: Array, u: Array, m: int) -> None:
    """Add an accepted normalised innovation (m,) to the drift."""
    for i in range(m):
        row[DRIFT + i] += _DRIFT_SHARE * (u[i] - row[DRIFT + i])


def q_scale(row: Array) -> float:
    """Return the factor on Q; a slow mean of the innovations that differs from 0 shows a drift."""
    drift = math.sqrt(row[DRIFT] ** 2 + row[DRIFT + 1] ** 2 + row[DRIFT + 2] ** 2)
    # Standard deviation of the mean if the innovations are white.
    usual = math.sqrt(3.0 * _DRIFT_SHARE / (2.0 - _DRIFT_SHARE))
    return math.exp(_infer(_Q_RULES, max(drift - usual, 0.0)))


def _infer(rules: Any, value: float) -> float:
    """Return the mean of the consequents, weighted by membership; beyond an outer center the mean is constant."""
    inside = min(max(value, rules[0][0]), rules[2][0])
    total, given = 0.0, 0.0
    for center, width, consequent in rules:
        away = (inside - center) / width
        weight = math.exp(-0.5 * away * away)
        total += weight
        given += weight * consequent
    return given / total
