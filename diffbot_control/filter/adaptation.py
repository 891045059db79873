"""Fuzzy-neural adaptation of the filter's R and Q to its innovations: pure functions with their memory.

A reconstruction, not the original: the paper names its filter an EKF-FNN, a fuzzy system that adjusts the covariances
and a neural network that tunes the memberships, and gives no equations. Here each channel is a zero-order Sugeno system
of three rules with Gaussian memberships (the network of ANFIS, Jang 1993), trained online by gradient descent.

R: the innovations divided by their expected deviations are white with variance 1 if R is right. Half the square of the
*difference* of two in a row has then the mean 1, too, and a drift, which both share, is not in it: a slipping wheel
must not be taken for a noisy sensor. Q: a drift shows in the slow mean of the innovations, and raises Q in proportion.
"""

from __future__ import annotations

import math
from typing import NamedTuple


class Rule(NamedTuple):
    """If the input is about ``center``, give ``consequent``."""

    center: float
    width: float
    consequent: float


class Rules(NamedTuple):
    """Three rules that overlap."""

    low: Rule
    middle: Rule
    high: Rule


class Channel(NamedTuple):
    """Adapts the scale of one part of R."""

    rules: Rules
    mean: float = 1.0
    """slow mean of half the squared difference; 1 if R is right"""
    log_scale: float = 0.0
    """of the factor on R"""
    pairs: int = 0
    """differences so far"""


class Adaptation(NamedTuple):
    """Memory of the adaptation."""

    position: Channel
    heading: Channel
    x: float = 0.0
    """normalised innovations of the fix before"""
    y: float = 0.0
    theta: float = 0.0
    fixes: int = 0
    """fixes so far"""
    expected: bool = False
    """the fix before was within the gate"""
    drift_x: float = 0.0
    """slow means of the normalised innovations"""
    drift_y: float = 0.0
    drift_theta: float = 0.0


# Chosen by simulation, so that R wrong by ten either way is found within some ten fixes and right R stays within a few
# per cent of accuracy (docs/localization.md).
_RULES = Rules(Rule(-0.8, 0.4, -0.14), Rule(0.0, 0.4, 0.0), Rule(5.0, 1.7, 1.8))
"""Input: the mean minus 1; output: change of the logarithm of the scale per fix. The high rule: R far too small."""
_Q_RULES = Rules(Rule(0.0, 0.35, 0.0), Rule(1.0, 0.35, 1.5), Rule(2.0, 0.5, 4.0))
"""Input: drift beyond the usual; output: logarithm of q, up to a factor of 55."""
_MEMORY, _DRIFT_MEMORY = 0.03, 0.1
"""Share of the newest fix in the slow means: they remember some 33 and 10 fixes."""
_RATE, _LEAK = 0.02, 0.02
"""Learning rate of the rules, and how much of what was learnt is forgotten with each fix."""
_CLIP = 30.0
"""Bound of half a squared difference: one outlier shall not say everything."""
_LEARNING = 5
"""Pairs of fixes at the start that count even if only one of the two was within the gate."""
_LARGEST = 1e6
"""Normalised innovations beyond it are all the same."""
_LOG_MOST = math.log(1e3)


def new_adaptation() -> Adaptation:
    """No adaptation yet."""
    channel = Channel(_RULES, 1.0, 0.0, 0)
    return Adaptation(channel, channel, 0.0, 0.0, 0.0, 0, False, 0.0, 0.0, 0.0)


def r_scales(adaptation: Adaptation) -> tuple[float, float]:
    """Factors on R for position and heading."""
    return math.exp(adaptation.position.log_scale), math.exp(adaptation.heading.log_scale)


def q_scale(adaptation: Adaptation) -> float:
    """Factor on Q."""
    drift = math.sqrt(adaptation.drift_x**2 + adaptation.drift_y**2 + adaptation.drift_theta**2)
    # Of white innovations the mean has this deviation.
    usual = math.sqrt(3.0 * _DRIFT_MEMORY / (2.0 - _DRIFT_MEMORY))
    return math.exp(infer(_Q_RULES, max(drift - usual, 0.0)))


def membership(rule: Rule, value: float) -> float:
    """How much ``value`` is what the rule is about."""
    away = (value - rule.center) / rule.width
    return math.exp(-0.5 * away * away) + 1e-12


def infer(rules: Rules, value: float) -> float:
    """Mean of the consequents, weighted by membership; beyond the outer rules these alone count."""
    inside = min(max(value, rules.low.center), rules.high.center)
    low, middle, high = membership(rules.low, inside), membership(rules.middle, inside), membership(rules.high, inside)
    given = low * rules.low.consequent + middle * rules.middle.consequent + high * rules.high.consequent
    return given / (low + middle + high)


def trained(rules: Rules, value: float, error: float) -> Rules:
    """One step of gradient descent on error^2 / 2, where the output lowers the error."""
    inside = min(max(value, rules.low.center), rules.high.center)
    low, middle, high = membership(rules.low, inside), membership(rules.middle, inside), membership(rules.high, inside)
    total = low + middle + high
    output = infer(rules, inside)
    return Rules(
        _trained_rule(rules.low, _RULES.low, inside, error, low / total, output),
        _trained_rule(rules.middle, _RULES.middle, inside, error, middle / total, output),
        _trained_rule(rules.high, _RULES.high, inside, error, high / total, output),
    )


def _trained_rule(rule: Rule, start: Rule, value: float, error: float, share: float, output: float) -> Rule:
    step = _RATE * error
    away = (value - rule.center) / rule.width
    slope = (rule.consequent - output) * share * away / rule.width
    return Rule(
        _kept(rule.center + step * slope, start.center, 0.3),
        _kept(rule.width + step * slope * away, start.width, 0.3),
        _kept(rule.consequent + step * share, start.consequent, 0.2),
    )


def _within(value: float, bound: float) -> float:
    return min(max(value, -bound), bound)


def _kept(value: float, start: float, bound: float) -> float:
    # What noise has taught is forgotten slowly, and nothing is learnt that turns the rules around.
    value += _LEAK * (start - value)
    return min(max(value, start - bound), start + bound)


def _adapted(channel: Channel, square: float) -> Channel:
    share = max(_MEMORY, 1.0 / (channel.pairs + 1.0))
    mean = channel.mean + share * (min(square, _CLIP) - channel.mean)
    error = mean - 1.0
    change = infer(channel.rules, error)
    log_scale = min(max(channel.log_scale + change, -_LOG_MOST), _LOG_MOST)
    # The mean was taken with the old scale; with the new one it would have been smaller.
    mean *= math.exp(channel.log_scale - log_scale)
    return Channel(trained(channel.rules, error, error), mean, log_scale, channel.pairs + 1)


def rescaled(before: Adaptation, after: Adaptation) -> float:
    """Factor on the pose's part of P when the scale of R grows: P was computed with a scale that was too small."""
    change = after.position.log_scale - before.position.log_scale + after.heading.log_scale - before.heading.log_scale
    # What P says too little of is taken back; that it says too much passes by itself, with the next measurements.
    return math.exp(max(0.5 * change, 0.0))


def adapted(adaptation: Adaptation, x: float, y: float, theta: float, expected: bool) -> Adaptation:
    """Take in the normalised innovation of a fix, also of a rejected one."""
    a = adaptation
    x, y, theta = _within(x, _LARGEST), _within(y, _LARGEST), _within(theta, _LARGEST)
    position, heading = a.position, a.heading
    # An outlier among good fixes has no neighbour of its kind.
    if a.fixes > 0 and (expected == a.expected or position.pairs < _LEARNING):
        position = _adapted(position, 0.25 * ((x - a.x) ** 2 + (y - a.y) ** 2))
        heading = _adapted(heading, 0.5 * (theta - a.theta) ** 2)
    share = _DRIFT_MEMORY if expected else 0.0
    return Adaptation(
        position,
        heading,
        x,
        y,
        theta,
        a.fixes + 1,
        expected,
        a.drift_x + share * (x - a.drift_x),
        a.drift_y + share * (y - a.drift_y),
        a.drift_theta + share * (theta - a.drift_theta),
    )
