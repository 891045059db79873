"""Fuzzy-neural adaptation of the filter's R and Q to its innovations: pure functions with their memory.

A reconstruction, not the original: the paper names its filter an EKF-FNN, a fuzzy system that adjusts the covariances
and a neural network that tunes the memberships, and gives no equations. Here each channel is a zero-order Sugeno system
of three rules with Gaussian memberships (the network of ANFIS, Jang 1993), trained online by gradient descent.

R: the innovations divided by their expected deviations are white with variance 1 if R is right. Half the square of the
*difference* of two consecutive ones has then the mean 1, too, and a drift, which both share, cancels: a slipping wheel
is not mistaken for a noisy sensor. Q: a drift shows in the slow mean of the innovations, and raises Q in proportion.
"""

from __future__ import annotations

import math
from typing import NamedTuple


class Rule(NamedTuple):
    """If the input is near ``center``, the output is ``consequent``."""

    center: float
    width: float
    consequent: float


class Rules(NamedTuple):
    """Three overlapping rules."""

    low: Rule
    middle: Rule
    high: Rule


class Channel(NamedTuple):
    """Adapts the scale of one part of R."""

    rules: Rules
    mean: float = 1.0
    """slow mean of half the squared difference; 1 if R is right"""
    log_scale: float = 0.0
    """logarithm of the factor on R"""
    pairs: int = 0
    """number of differences so far"""


class Normalised(NamedTuple):
    """Innovation of a fix, each number divided by its expected standard deviation [-]."""

    x: float
    y: float
    theta: float
    """nan: the fix has no heading"""


class Adaptation(NamedTuple):
    """Memory of the adaptation."""

    position: Channel
    heading: Channel
    innovation: Normalised
    """of the fix before"""
    drift: Normalised
    """slow mean of the innovations"""
    fixes: int
    """number of fixes so far"""
    expected: bool
    """the fix before was within the gate"""


# Chosen by simulation, so that R wrong by ten either way is found within some ten fixes and right R stays within a few
# per cent of accuracy (docs/results/data/localization.json).
_RULES = Rules(Rule(-0.8, 0.4, -0.14), Rule(0.0, 0.4, 0.0), Rule(5.0, 1.7, 1.8))
"""Input: the mean minus 1; output: change of the logarithm of the scale per fix. The high rule: R far too small."""
_Q_RULES = Rules(Rule(0.0, 0.35, 0.0), Rule(1.0, 0.35, 1.5), Rule(2.0, 0.5, 4.0))
"""Input: drift beyond that of white innovations; output: logarithm of q, up to a factor of 55."""
_MEMORY, _DRIFT_MEMORY = 0.03, 0.1
"""Share of the newest fix in the slow means: they remember some 33 and 10 fixes."""
_RATE, _LEAK = 0.02, 0.02
"""Learning rate of the rules, and the share by which they return to their initial values with each fix."""
_CLIP = 30.0
"""Bound of half a squared difference: a single outlier must not dominate the mean."""
_INITIAL_PAIRS = 5
"""Number of pairs of fixes at the start that count even if only one of the two was within the gate."""
_MAX_INNOVATION = 1e6
"""Bound of a normalised innovation."""
_MAX_LOG_SCALE = math.log(1e3)


def new_adaptation() -> Adaptation:
    """Return the memory of an adaptation that has received no fix."""
    channel = Channel(_RULES, 1.0, 0.0, 0)
    zero = Normalised(0.0, 0.0, 0.0)
    return Adaptation(channel, channel, zero, zero, 0, False)


def r_scales(adaptation: Adaptation) -> tuple[float, float]:
    """Factors on R for position and heading."""
    return math.exp(adaptation.position.log_scale), math.exp(adaptation.heading.log_scale)


def q_scale(adaptation: Adaptation) -> float:
    """Factor on Q."""
    x, y, theta = adaptation.drift
    drift = math.sqrt(x**2 + y**2 + theta**2)
    # Standard deviation of the mean if the innovations are white.
    usual = math.sqrt(3.0 * _DRIFT_MEMORY / (2.0 - _DRIFT_MEMORY))
    return math.exp(infer(_Q_RULES, max(drift - usual, 0.0)))


def membership(rule: Rule, value: float) -> float:
    """Degree to which the rule applies to ``value``, in (0, 1]."""
    away = (value - rule.center) / rule.width
    return math.exp(-0.5 * away * away) + 1e-12


def infer(rules: Rules, value: float) -> float:
    """Mean of the consequents weighted by membership; the input is limited to the centers of the outer rules."""
    inside = min(max(value, rules.low.center), rules.high.center)
    low, middle, high = membership(rules.low, inside), membership(rules.middle, inside), membership(rules.high, inside)
    given = low * rules.low.consequent + middle * rules.middle.consequent + high * rules.high.consequent
    return given / (low + middle + high)


def train(rules: Rules, value: float, error: float) -> Rules:
    """Do one step of gradient descent on error^2 / 2, where a larger output lowers the error."""
    inside = min(max(value, rules.low.center), rules.high.center)
    low, middle, high = membership(rules.low, inside), membership(rules.middle, inside), membership(rules.high, inside)
    total = low + middle + high
    output = infer(rules, inside)
    return Rules(
        _train_rule(rules.low, _RULES.low, inside, error, low / total, output),
        _train_rule(rules.middle, _RULES.middle, inside, error, middle / total, output),
        _train_rule(rules.high, _RULES.high, inside, error, high / total, output),
    )


def _train_rule(rule: Rule, start: Rule, value: float, error: float, share: float, output: float) -> Rule:
    step = _RATE * error
    away = (value - rule.center) / rule.width
    slope = (rule.consequent - output) * share * away / rule.width
    return Rule(
        _bounded(rule.center + step * slope, start.center, 0.3),
        _bounded(rule.width + step * slope * away, start.width, 0.3),
        _bounded(rule.consequent + step * share, start.consequent, 0.2),
    )


def _within(value: float, bound: float) -> float:
    return min(max(value, -bound), bound)


def _bounded(value: float, start: float, bound: float) -> float:
    # The leak removes slowly what was learnt from noise; the bound keeps the order of the rules.
    value += _LEAK * (start - value)
    return min(max(value, start - bound), start + bound)


def _adapt_channel(channel: Channel, square: float) -> Channel:
    share = max(_MEMORY, 1.0 / (channel.pairs + 1.0))
    mean = channel.mean + share * (min(square, _CLIP) - channel.mean)
    error = mean - 1.0
    change = infer(channel.rules, error)
    log_scale = min(max(channel.log_scale + change, -_MAX_LOG_SCALE), _MAX_LOG_SCALE)
    # The mean belongs to the old scale: convert it to the new one.
    mean *= math.exp(channel.log_scale - log_scale)
    return Channel(train(channel.rules, error, error), mean, log_scale, channel.pairs + 1)


def inflation(before: Adaptation, after: Adaptation) -> float:
    """Factor on the pose's part of P when the scale of R grows: P was computed with a scale that was too small."""
    change = after.position.log_scale - before.position.log_scale + after.heading.log_scale - before.heading.log_scale
    # Only a P that is too small is corrected; one that is too large shrinks by itself with the next measurements.
    return math.exp(max(0.5 * change, 0.0))


def adapt(adaptation: Adaptation, innovation: Normalised, expected: bool) -> Adaptation:
    """Update the adaptation with a fix, accepted or rejected.

    Args:
        adaptation: memory.
        innovation: of the fix.
        expected: the fix is within the gate.
    """
    last, drift = adaptation.innovation, adaptation.drift
    x, y, theta = innovation
    x, y, theta = _within(x, _MAX_INNOVATION), _within(y, _MAX_INNOVATION), _within(theta, _MAX_INNOVATION)
    position, heading = adaptation.position, adaptation.heading
    # Outliers are isolated: a pair of an outlier and a good fix is no sample of the noise.
    if adaptation.fixes > 0 and (expected == adaptation.expected or position.pairs < _INITIAL_PAIRS):
        position = _adapt_channel(position, 0.25 * ((x - last.x) ** 2 + (y - last.y) ** 2))
        turn = theta - last.theta
        if not math.isnan(turn):
            heading = _adapt_channel(heading, 0.5 * turn**2)
    share = _DRIFT_MEMORY if expected else 0.0
    return Adaptation(
        position,
        heading,
        Normalised(x, y, theta),
        Normalised(
            drift.x + share * (x - drift.x),
            drift.y + share * (y - drift.y),
            drift.theta if math.isnan(theta) else drift.theta + share * (theta - drift.theta),
        ),
        adaptation.fixes + 1,
        expected,
    )
