"""Noise statistic of one source of measurements: estimates the scale and the correlation of its errors.

Model: the errors of a source have the covariance s R, where R is the claimed covariance. Each error is c times the
previous error plus an independent part. Two means over pairs of neighbouring measurements determine s and c:

- The difference of two neighbours, corrected by the motion between them. Half its square has the mean s (1 - c) R plus
  the variance of the odometry. A drift of the estimate cancels in the difference.
- The product of two neighbouring innovations. Its mean is s c R, minus the part of the errors that the filter follows.
  If the errors are independent, the mean is 0.

The statistic of a source is one row of an array. A row has two channels: one for positions and ranges, one for headings
and bearings. It also contains the mean NIS and the autocorrelation of the innovations, which show an overconfident
filter. All functions run as plain Python and, compiled unchanged, in the simulation.
"""

from __future__ import annotations

import math
from typing import Any

from diffbot_control.filter.models import Array

DIFFERENCE, MOTION, PRODUCT, SQUARE, PAIRS, NUMBERS, SCALE = 0, 1, 2, 3, 4, 5, 6
"""Columns of a channel. The first four are slow means in units of R: half the squared difference of neighbours, the
contribution of the motion to this difference, the product of neighbouring innovations, and the squared innovation. Then
follow the number of pairs, the number of scalars in them, and the factor on R."""
CHANNEL = 7
"""Number of columns of a channel."""
PERIOD, TIME = 14, 15
"""[s] Mean time between neighbours, and correlation time of the errors; 0: the errors are independent."""
NIS, NIS_NUMBERS, WHITENESS, WHITENESS_NUMBERS = 16, 17, 18, 19
"""Mean NIS per scalar, mean product of neighbouring normalised innovations, and the number of scalars in each mean."""
DRIFT = 20
"""First of three columns: slow means of the normalised innovations of x, y and theta."""
COLUMNS = 23

_MEMORY = 200.0
"""Length of the slow means, in pairs."""
_NIS_MEMORY, _WHITENESS_MEMORY = 150.0, 300.0
"""Lengths of the means of the NIS and of the autocorrelation, in scalars."""
_MAX_DIFFERENCE = 30.0
"""Largest half squared difference in units of R. If it is larger, one of the two measurements is an outlier."""
_MIN_DIFFERENCE = 1e-9
"""Smallest half squared difference in units of R. If it is smaller, the source repeats its value, and the pair contains
no information about the noise."""
_MAX_MOTION = 1.0
"""Largest variance of the motion between two measurements, in units of R. If it is larger, the motion dominates the
difference."""
_SIGNIFICANT, _SIGNIFICANT_SCALE = 2.0, 3.0
"""Bounds of significance in standard deviations: of the mean product from 0, and of the scale from 1."""
_MIN_PAIRS = 10.0
"""Smallest number of pairs from which a scale is estimated."""
_MAX_CORRELATION = 0.99
_MIN_DT = 1e-3
"""[s] Shortest time between two measurements for which a correlation is computed; avoids a division by 0."""
_MAX_SCALE = 1e3


def clear(row: Array) -> None:
    """Initialise the row of a source."""
    row[:] = 0.0
    for channel in range(2):
        row[channel * CHANNEL + SCALE] = row[channel * CHANNEL + DIFFERENCE] = 1.0


def clear_innovations(row: Array) -> None:
    """Clear the means of NIS, autocorrelation and drift after a jump of the estimate."""
    row[NIS : DRIFT + 3] = 0.0


def scale_of(row: Array, angle: bool) -> float:
    """Return the estimated factor on the claimed variances of angles if ``angle``, else of positions and ranges."""
    return float(row[CHANNEL + SCALE if angle else SCALE])


def inflation_after(dt: float, time: float) -> float:
    """Return (1 + c) / (1 - c), where c = exp(-dt / time) is the correlation of errors ``dt`` [s] apart.

    Over many measurements, correlated errors of covariance R carry as much information as independent errors of
    covariance R (1 + c) / (1 - c). A correlation time of 0 means independent errors.
    """
    return 1.0 / math.tanh(0.5 * max(dt, _MIN_DT) / time) if time > 0.0 else 1.0


def inflation(row: Array, dt: float, time: float, landmark: bool) -> float:
    """Return the factor by which R is inflated for time-correlated errors.

    Args:
        row: row of the source.
        dt: time since the previous measurement [s].
        time: known correlation time of the errors [s]; 0: use the estimated correlation time.
        landmark: True for measurements of landmarks. The filter does not follow the errors of single landmarks. If
            their innovations are smaller than R claims, R already covers a part of the correlation.
    """
    if time > 0.0:
        return inflation_after(dt, time)
    square = min(_pooled(row, SQUARE), 1.0) if landmark else 1.0
    return max(square * inflation_after(dt, float(row[TIME])), 1.0)


def assumed_correlation(row: Array, time: float) -> float:
    """Return the correlation of neighbouring errors that the filter assumes; ``time`` is as in :func:`inflation`."""
    time = time if time > 0.0 else float(row[TIME])
    return math.exp(-max(float(row[PERIOD]), _MIN_DT) / time) if time > 0.0 else 0.0


def add_innovation(row: Array, nis: float, product: float, m: int, paired: bool) -> None:
    """Add an accepted innovation to the means of NIS and autocorrelation.

    Args:
        row: row of the source.
        nis: NIS of the measurement.
        product: scalar product of the normalised innovation and the previous normalised innovation.
        m: number of scalars in the measurement.
        paired: True if there is a previous measurement.
    """
    row[NIS_NUMBERS] = min(float(row[NIS_NUMBERS]) + m, _NIS_MEMORY)
    row[NIS] += m / row[NIS_NUMBERS] * (nis / m - row[NIS])
    if paired:
        row[WHITENESS_NUMBERS] = min(float(row[WHITENESS_NUMBERS]) + m, _WHITENESS_MEMORY)
        row[WHITENESS] += m / row[WHITENESS_NUMBERS] * (product / m - row[WHITENESS])


def add_pair(row: Array, sums: Array, dt: float) -> None:
    """Add a pair of neighbouring measurements to the slow means, unless it contains no information about the noise.

    Args:
        row: row of the source.
        sums: (2, 5) array with one row per channel. Its columns are the sums of DIFFERENCE, MOTION, PRODUCT and SQUARE
            over the scalars of the channel, and the number of these scalars.
        dt: time between both measurements [s].
    """
    difference, numbers, motion = 0.0, 0.0, 0.0
    for channel in range(2):
        numbers += float(sums[channel, 4])
        difference += float(sums[channel, DIFFERENCE]) / float(row[channel * CHANNEL + SCALE])
        motion += float(sums[channel, MOTION])
    if dt <= 0.0 or numbers == 0.0 or motion >= _MAX_MOTION * numbers:
        return
    if not _MIN_DIFFERENCE * numbers < difference < _MAX_DIFFERENCE * numbers:
        return
    max_count = 0.0
    for channel in range(2):
        first, size = channel * CHANNEL, float(sums[channel, 4])
        if size > 0.0:
            count = min(float(row[first + PAIRS]) + 1.0, _MEMORY)
            row[first + PAIRS], row[first + NUMBERS] = count, count * size
            row[first : first + 4] += (sums[channel, :4] / size - row[first : first + 4]) / count
            max_count = max(max_count, count)
    row[PERIOD] += (dt - row[PERIOD]) / max_count


def _pooled(row: Array, column: int) -> float:
    """Return the mean of a column over the scalars of both channels."""
    first, second = float(row[NUMBERS]), float(row[CHANNEL + NUMBERS])
    if first + second == 0.0:
        return 1.0
    return (float(row[column]) * first + float(row[CHANNEL + column]) * second) / (first + second)


def update_scale_and_time(row: Array) -> None:
    """Set the scale of R and the correlation time from the slow means.

    If the correlation is significant, the scale is 1. Otherwise the scale is the mean difference if this mean is
    significantly above 1. The scale is never below 1: a constant error, such as a wrong position on the map, cancels in
    the differences, so a scale below 1 would make the filter overconfident.
    """
    c = _correlation(row)
    row[TIME] = -row[PERIOD] / math.log(c) if c > 0.0 else 0.0
    for channel in range(2):
        first, scale = channel * CHANNEL, 1.0
        pairs, numbers = float(row[first + PAIRS]), float(row[first + NUMBERS])
        if c == 0.0 and pairs >= _MIN_PAIRS:
            white = _white_part(float(row[first + DIFFERENCE]), float(row[first + MOTION]))
            # Half a squared difference of white noise has a variance of 2. The correlation of neighbouring pairs, which
            # have one measurement in common, increases the variance of the mean by half.
            if white - 1.0 > _SIGNIFICANT_SCALE * math.sqrt(3.0 / numbers) * white:
                scale = min(white, _MAX_SCALE)
        row[first + SCALE] = scale


def _white_part(difference: float, motion: float) -> float:
    """Return a mean difference minus the variance of the motion.

    At most half the difference is subtracted, since odometry is often more accurate than its covariance claims.
    """
    return max(difference - min(motion, 0.5 * difference), 1e-3)


def _correlation(row: Array) -> float:
    """Return the correlation of neighbouring errors; 0 if it is not significant."""
    difference, product = _pooled(row, DIFFERENCE), _pooled(row, PRODUCT)
    white = _white_part(difference, _pooled(row, MOTION))
    numbers = row[NUMBERS] + row[CHANNEL + NUMBERS]
    if white >= 1.0 or product <= 0.0:
        return 0.0
    # If the innovations are white, the mean product has the mean 0 and the deviation variance / sqrt(numbers).
    variance = difference + product
    if product * product * numbers <= (_SIGNIFICANT * variance) ** 2:
        return 0.0
    return min(1.0 - white, product / (product + white), _MAX_CORRELATION)


_R_RULES = (-1.0, 0.7, -0.2), (0.0, 0.7, 0.0), (1.0, 0.7, 0.2)
"""Center, width and consequent of each rule. Input: log of the measured scale over the current scale. Output:
change of log scale."""
_Q_RULES = (0.0, 0.35, 0.0), (1.0, 0.35, 1.5), (2.0, 0.5, 4.0)
"""Center, width and consequent of each rule. Input: excess of the drift over the drift of white innovations. Output:
log of the factor on Q."""
_DRIFT_SHARE = 0.1
"""Weight of the newest innovation in the drift."""


def update_scale_by_rules(row: Array) -> None:
    """Set the scale of R by three fuzzy rules.

    This is a reconstruction. The paper (reference 11) names a fuzzy system that adjusts the covariances, but gives no
    equations. Here it is a zero-order Sugeno system with Gaussian memberships on the means of :func:`add_pair`.
    """
    for channel in range(2):
        part = row[channel * CHANNEL : (channel + 1) * CHANNEL]
        if part[PAIRS] > 0.0:
            log_ratio = math.log(_white_part(float(part[DIFFERENCE]), float(part[MOTION])) / float(part[SCALE]))
            scale = float(part[SCALE]) * math.exp(_infer(_R_RULES, log_ratio))
            part[SCALE] = min(max(scale, 1.0 / _MAX_SCALE), _MAX_SCALE)


def add_drift(row: Array, u: Array, m: int) -> None:
    """Add an accepted normalised innovation (m,) to the drift."""
    for i in range(m):
        row[DRIFT + i] += _DRIFT_SHARE * (u[i] - row[DRIFT + i])


def q_scale(row: Array) -> float:
    """Return the factor on Q, which is above 1 if the mean of the innovations shows a drift of the estimate."""
    drift = math.sqrt(row[DRIFT] ** 2 + row[DRIFT + 1] ** 2 + row[DRIFT + 2] ** 2)
    # Root mean square of the drift if the innovations are white.
    white_drift = math.sqrt(3.0 * _DRIFT_SHARE / (2.0 - _DRIFT_SHARE))
    return math.exp(_infer(_Q_RULES, max(drift - white_drift, 0.0)))


def _infer(rules: Any, value: float) -> float:
    """Return the mean of the consequents weighted by membership. ``value`` is clipped to the outer centers."""
    clipped = min(max(value, rules[0][0]), rules[2][0])
    total, weighted = 0.0, 0.0
    for center, width, consequent in rules:
        distance = (clipped - center) / width
        weight = math.exp(-0.5 * distance * distance)
        total += weight
        weighted += weight * consequent
    return weighted / total
