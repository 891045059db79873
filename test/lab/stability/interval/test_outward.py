"""The compiled interval functions hold the exact range of every box, by Arb's ball arithmetic, and are tight."""

import math
from itertools import product

import numpy as np
import pytest
from flint import arb, ctx

from diffbot_lab.stability.interval import outward
from diffbot_lab.stability.interval.compiled import compile_bounds

BOXES = 2000
"""of each case"""
HALF_PI = 1.5707963267948966
SINC = [4.493409457909064, 7.725251836937707]
"""[rad] local extremes of sin(x)/x, to the last bit"""


def sinc(x):
    return x.sin() / x if x != 0 else arb(1)


def tanhc(x):
    return x.tanh() / x if x != 0 else arb(1)


def nowhere(low, high):
    return []


def zero(low, high):
    return [0.0] if low < 0.0 < high else []


def quarters(low, high):
    """Four in a row hold both extremes."""
    turns = range(math.ceil(low / HALF_PI), math.floor(high / HALF_PI) + 1)[:4]
    return [one for one in (arb.pi() * number / 2 for number in turns) if low < one < high]


def humps(low, high):
    return zero(low, high) + [one for x in SINC for one in (x, -x) if low < one < high]


# name: exact value, its extremes inside a side, (centre, spread) of each side, ulp by which a bound may be off
CASES = {
    "add": (lambda x, y: x + y, nowhere, [(0, 20), (0, 20)], 2),
    "sub": (lambda x, y: x - y, nowhere, [(0, 20), (0, 20)], 2),
    "mul": (lambda x, y: x * y, nowhere, [(0, 20), (0, 20)], 2),
    "div": (lambda x, y: x / y, nowhere, [(0, 20), (-11, 10)], 2),
    "hypot": (lambda x, y: (x * x + y * y).sqrt(), zero, [(0, 20), (0, 20)], 4),
    "atan2": (arb.atan2, nowhere, [(0, 10), (11, 10)], 10),
    "atan2 aside": (arb.atan2, nowhere, [(-11, 10), (0, 10)], 10),
    "atan2 at the cut": (lambda y, x: arb.pi() + arb.atan2(-y, -x), nowhere, [(0, 10), (-11, 10)], 12),
    "sqr": (lambda x: x * x, zero, [(0, 20)], 2),
    "sqrt": (arb.sqrt, nowhere, [(11, 11)], 2),
    "sin": (arb.sin, quarters, [(0, 4)], 10),
    "sin far away": (arb.sin, quarters, [(0, 300)], 10),
    "cos": (arb.cos, quarters, [(0, 4)], 10),
    "cos far away": (arb.cos, quarters, [(0, 300)], 10),
    "atan": (arb.atan, nowhere, [(0, 20)], 10),
    "asin": (arb.asin, nowhere, [(0, 1)], 10),
    "tanh": (arb.tanh, nowhere, [(0, 20)], 10),
    "sinc": (sinc, zero, [(0, 4.4)], 12),
    "sinc far away": (sinc, humps, [(0, 30)], math.inf),
    "tanhc": (tanhc, zero, [(0, 20)], 12),
}


FUNCTIONS = ("add", "sub", "mul", "div", "hypot", "atan2", "sqr", "sqrt", "sin", "cos", "atan", "asin", "tanh")
FUNCTIONS += ("sinc", "tanhc")


def evaluate_all(boxes, out):
    """Evaluate every function, also outside of its domain, so that one kernel serves all cases."""
    for i in range(len(boxes)):
        a0, a1, b0, b1 = boxes[i]
        out[0, i], out[1, i] = outward.add(a0, a1, b0, b1), outward.sub(a0, a1, b0, b1)
        out[2, i], out[3, i] = outward.mul(a0, a1, b0, b1), outward.div(a0, a1, b0, b1)
        out[4, i], out[5, i] = outward.hypot(a0, a1, b0, b1), outward.atan2(a0, a1, b0, b1)
        out[6, i], out[7, i] = outward.sqr(a0, a1), outward.sqrt(a0, a1)
        out[8, i], out[9, i], out[10, i] = outward.sin(a0, a1), outward.cos(a0, a1), outward.atan(a0, a1)
        out[11, i], out[12, i] = outward.asin(a0, a1), outward.tanh(a0, a1)
        out[13, i], out[14, i] = outward.sinc(a0, a1), outward.tanhc(a0, a1)


KERNEL = compile_bounds(evaluate_all)


def bounds_of(name, boxes):
    found = np.zeros((len(FUNCTIONS), len(boxes), 2))
    KERNEL(boxes, found)
    return found[FUNCTIONS.index(name.split()[0])]


def random_sides(rng, centre, spread):
    """Sides of every size, from a point to the whole range, and about a tenth that touch 0."""
    ends = rng.uniform(-spread, spread, (BOXES, 2))
    narrow = ends[:, :1] + ends[:, 1:] * 10.0 ** rng.uniform(-17.0, 0.0, (BOXES, 1)) * [0.0, 1.0]
    sides = np.where(rng.random((BOXES, 1)) < 0.7, np.clip(narrow, -spread, spread), ends)
    sides[rng.random(BOXES) < 0.05, 0] = 0.0
    sides[rng.random(BOXES) < 0.05, 1] *= 10.0 ** rng.uniform(-12.0, 0.0)
    return np.sort(centre + sides, axis=1)


def random_boxes(rng, name):
    boxes = np.zeros((BOXES, 4))
    ranges = CASES[name][2]
    boxes[:, : 2 * len(ranges)] = np.hstack([random_sides(rng, *one) for one in ranges])
    if name == "atan2 at the cut":
        boxes[:, :2] = np.abs(boxes[:, :2]) * [-1.0, 1.0]
    return boxes


def exact_values(value, extremes, sides):
    """Balls around the values at the ends of the sides and at the extremes between them."""
    points = [[arb(one) for one in (low, high, *extremes(low, high))] for low, high in sides]
    return [value(x) for x in points[0]] if len(points) == 1 else [value(x, y) for x, y in product(*points)]


def sorted_ends(values):
    return min(values), max(values)


@pytest.mark.parametrize("name", CASES)
def test_holds_the_exact_range_and_is_tight(name):
    value, extremes, ranges, ulps = CASES[name]
    boxes = random_boxes(np.random.default_rng(1), name)
    found = bounds_of(name, boxes)
    exact = np.zeros((BOXES, 2))
    ctx.prec = 120
    for i, box in enumerate(boxes.tolist()):
        values = exact_values(value, extremes, [box[:2], box[2:]][: len(ranges)])
        exact[i] = floats = sorted_ends([float(one) for one in values])
        if not (found[i, 0] < floats[0] and found[i, 1] > floats[1]):
            # Not beyond the next float. At an extreme the bound is exact, and lies in a ball of 120 bits.
            low, high = map(arb, found[i].tolist())
            assert all(low <= one or one.contains(low) for one in values), box
            assert all(high >= one or one.contains(high) for one in values), box
    assert np.abs(found - exact).max(initial=0.0, where=exact == 0.0) < 1e-300
    assert (np.abs(found - exact) <= ulps * np.spacing(np.abs(exact)) + 1e-300).all()


def test_up_and_down_leave_every_float():
    rng = np.random.default_rng(5)
    numbers = rng.uniform(-2.0, 2.0, 10_000) * 10.0 ** rng.uniform(-320.0, 290.0, 10_000)
    powers = 2.0 ** np.arange(-1074, 1000)
    for x in np.concatenate([numbers, powers, -powers, [0.0]]).tolist():
        assert outward.up(x) >= math.nextafter(x, math.inf)
        assert outward.down(x) <= math.nextafter(x, -math.inf)
        if abs(x) > 1e-290:
            assert outward.up(x) == math.nextafter(x, math.inf)
            assert outward.down(x) == math.nextafter(x, -math.inf)


def test_constants_enclose_pi():
    assert arb(outward.PI_LOW) < arb.pi() < arb(outward.PI_HIGH)
    assert math.nextafter(outward.PI_LOW, 4.0) == outward.PI_HIGH


def test_no_bound_is_never_mistaken_for_one():
    assert outward.div(1.0, 2.0, -1.0, 1.0) == (-math.inf, math.inf)
    assert outward.div(1.0, 2.0, 0.0, 1.0) == (-math.inf, math.inf)
    assert all(math.isnan(one) for one in outward.sqrt(-2.0, -1.0) + outward.asin(1.5, 2.0))
    assert outward.atan2(-1.0, 1.0, -1.0, 1.0) == (-outward.PI_HIGH, outward.PI_HIGH)
    assert outward.atan2(0.0, 0.0, -2.0, -1.0)[0] <= math.pi <= outward.atan2(0.0, 0.0, -2.0, -1.0)[1]
    assert outward.sin(-1e300, 1e300) == outward.cos(0.0, 7.0) == (-1.0, 1.0)
