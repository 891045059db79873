"""Extreme configurations: each parameter at both bounds and between them, alone, in pairs and in groups."""

import math
from typing import get_origin

import numpy as np

from diffbot_core.errors import DiffbotError
from diffbot_core.schema import build, parameters_of, to_dict

SMALLEST = 1e-12
"""Smallest random value above a bound of 0, as a share of the range."""


def extreme_values(parameter, present, rng):
    """Return both bounds, inf if it is allowed, and a random value between; a list gets one value for all its items."""
    kind, spec = parameter.type, parameter.spec
    if get_origin(kind) is tuple and present and isinstance(present[0], float):
        one = parameter._replace(type=float)
        return [(value,) * len(present) for value in extreme_values(one, present[0], rng)]
    if get_origin(kind) is tuple or (kind is str and not spec.choices):
        return []
    if kind is bool:
        return [False, True]
    if spec.choices:
        return list(spec.choices)
    values = [spec.minimum, spec.maximum, *([math.inf] if spec.allow_inf else [])]
    values.append(log_between(spec.minimum, spec.maximum, rng))
    return [round(value) if kind is int else value for value in values]


def log_between(low, high, rng):
    """Return a number with a random logarithm, and with a random sign if the range has both signs."""
    if low < 0.0 and (high <= 0.0 or rng.random() < 0.5):
        return -log_between(max(-high, 0.0), -low, rng)
    span = high - max(low, 0.0)
    smallest = max(low, SMALLEST * span)
    return float(min(math.exp(rng.uniform(math.log(smallest), math.log(high))), high))


def extreme_configs(config_type, seed, pairs, base=None, without=()):
    """Yield (values, configuration): every parameter alone at each extreme, then random pairs, then groups of six.

    Combinations that the configuration refuses with a DiffbotError are omitted.
    """
    rng = np.random.default_rng(seed)
    base = config_type() if base is None else base
    present = to_dict(base)
    parameters = [one for one in parameters_of(config_type) if one.name not in without]
    drawn = [(one.name, value) for one in parameters for value in extreme_values(one, present[one.name], rng)]
    for count in [1] * len(drawn) + [2] * pairs + [6] * (pairs // 4):
        if count == 1:
            values = dict([drawn.pop()])
        else:
            chosen = rng.choice(len(parameters), count, replace=False)
            several = (parameters[place] for place in chosen)
            options = {one.name: extreme_values(one, present[one.name], rng) for one in several}
            values = {name: values[rng.integers(len(values))] for name, values in options.items() if values}
        try:
            config = build(config_type, values, base)
        except DiffbotError:
            continue
        yield values, config


def assert_finite(thing, *context):
    """Fail with the context if a number in nested tuples, lists and arrays is not finite."""
    if isinstance(thing, (tuple, list)):
        for one in thing:
            assert_finite(one, *context)
    elif thing is not None and not isinstance(thing, (str, bytes)):
        assert np.isfinite(thing).all(), (thing, *context)
