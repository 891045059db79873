"""Quantiles from bounded storage against numpy's of all values."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from diffbot_bag.tools.quantiles import ACCURACY, Quantiles

INTEGERS = st.integers(-(2**62), 2**62) | st.integers(-5, 5)


@given(st.lists(st.lists(INTEGERS, max_size=30), min_size=1, max_size=4), st.floats(0.0, 1.0))
def test_a_quantile_is_within_the_accuracy_of_the_exact_one(parts, share):
    quantiles = Quantiles()
    for part in parts:
        quantiles.add(np.array(part, np.int64))
    values = np.sort(np.array([one for part in parts for one in part], np.int64))
    if len(values) == 0:
        assert math.isnan(quantiles.quantile(share))
        return
    exact = values[max(0, math.ceil(share * len(values)) - 1)]
    assert quantiles.quantile(share) == pytest.approx(exact, rel=ACCURACY, abs=0.0)
    assert (quantiles.count, quantiles.smallest, quantiles.largest) == (len(values), values[0], values[-1])


def test_equal_values_are_exact():
    quantiles = Quantiles()
    quantiles.add(np.full(9, 100_000_000))
    assert quantiles.quantile(0.99) == 100_000_000


def test_storage_is_bounded_over_all_64_bit_numbers():
    quantiles, random = Quantiles(), np.random.default_rng(5)
    for _ in range(5):
        size = np.exp(random.uniform(0.0, 62.0 * math.log(2.0), 50_000))
        quantiles.add((size * random.choice((-1, 1), 50_000)).astype(np.int64))
    assert quantiles.count == 250_000
    assert len(quantiles._counts) < 44_000
