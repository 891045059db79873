"""The checker's ranges contain the exact range of every box, computed by Arb's ball arithmetic, and are tight."""

import math
from itertools import product

import numpy as np
import pytest
from flint import arb, ctx
from tuned_steps import LAW, PLAN

from diffbot_lab.stability import checker_bounds as commands
from diffbot_lab.stability.checker_bounds import bearing_error, checker_loop

BOXES = 1000
"""number of boxes of each case"""
LOOP = checker_loop(LAW, PLAN)
PI = math.pi
LOWEST_SINC = 4.493409457909064
"""[rad] argument of the minimum of sin(x) / x, to the last bit"""


def sinc(x):
    return x.sin() / x if x != 0 else arb(1)


def speed(d, brake=LOOP.brake, react=LOOP.react, largest=LOOP.v_max):
    """Return the law's form of the braking profile, which differs from the checker's form."""
    d, brake, react = arb(d), arb(brake), arb(react)
    return min(2 * d / (react + (react * react + 2 * d / brake).sqrt()), arb(largest))


def turn(a):
    size = speed(abs(a), LOOP.turn_brake, LOOP.turn_react, LOOP.omega_max)
    return size if a >= 0 else -size


def slow_speed(d):
    return speed(d, react=LOOP.slow_react)


def steering(low, high):
    arguments = LOOP.turn_brake, LOOP.turn_react, LOOP.omega_max
    slack = commands.SLACK
    return commands.signed_profile(low, *arguments) - slack, commands.signed_profile(high, *arguments) + slack


# name: bounds, exact value, extremes inside, (low, high) of each side, largest difference from the exact bounds
CASES = {
    "cosine": (commands.cosine_range, arb.cos, [0.0, PI, -PI], [(-2.0 * PI, 2.0 * PI)], 1e-9),
    "sinc": (commands.sinc_range, sinc, [0.0, LOWEST_SINC, -LOWEST_SINC], [(-7.0, 7.0)], 1e-9),
    "product": (lambda a, b, c, d: commands.product((a, b), (c, d)), lambda x, y: x * y, [], [(-20.0, 20.0)] * 2, 1e-9),
    "fastest approach": (lambda a, b: commands.approach_range(LOOP, a, b), speed, [], [(1e-3, 20.0)], math.inf),
    "slowest approach": (lambda a, b: commands.approach_range(LOOP, a, b), slow_speed, [], [(1e-3, 20.0)], math.inf),
    "approach per distance": (
        lambda a, b: commands.per_distance_range(LOOP, a, b), lambda d: slow_speed(d) / d, [], [(1e-2, 20.0)], math.inf,
    ),
    "steering": (steering, turn, [], [(-PI, PI)], 1e-9),
    "bearing": (
        lambda a, b: (bearing_error(LOOP, b) - 1e-9, bearing_error(LOOP, a)), lambda r: (LOOP.eps_rho / r).asin(), [],
        [(0.07, 20.0)], 1e-8,
    ),
}  # fmt: skip


def random_boxes(rng, ranges):
    """Return boxes with sides of every size, from a point to the whole range. Some sides begin at the low end."""
    sides = []
    for low, high in ranges:
        ends = rng.uniform(low, high, (BOXES, 2))
        narrow = ends[:, :1] + (high - low) * 10.0 ** rng.uniform(-12.0, 0.0, (BOXES, 1)) * [0.0, 1.0]
        side = np.where(rng.random((BOXES, 1)) < 0.7, np.clip(narrow, low, high), ends)
        side[rng.random(BOXES) < 0.05, 0] = low
        sides.append(np.sort(side, axis=1))
    return np.hstack(sides)


@pytest.mark.parametrize("name", CASES)
def test_a_range_contains_the_exact_range_and_is_tight(name):
    bounds, value, extremes, ranges, tight = CASES[name]
    ctx.prec = 120
    for box in random_boxes(np.random.default_rng(1), ranges).tolist():
        sides = list(zip(box[::2], box[1::2], strict=True))
        points = [[arb(x) for x in side] + [arb(x) for x in extremes if side[0] < x < side[1]] for side in sides]
        values = [value(*at) for at in product(*points)]
        low, high = bounds(*box)
        assert all(arb(low) <= one <= arb(high) for one in values), box
        assert float(min(values)) - low <= tight, box
        assert high - float(max(values)) <= tight, box


def test_the_range_of_the_approach_covers_all_standard_deviations_and_is_tight():
    """The range is from the slowest speed at the near end to the fastest speed at the far end."""
    low, high = commands.approach_range(LOOP, 0.3, 0.4)
    assert (low, high) == pytest.approx((float(slow_speed(0.3)), float(speed(0.4))), abs=1e-9)
    low, high = commands.per_distance_range(LOOP, 0.3, 0.4)
    assert (low, high) == pytest.approx((float(slow_speed(0.4) / 0.4), float(speed(0.3) / arb(0.3))), abs=1e-9)
