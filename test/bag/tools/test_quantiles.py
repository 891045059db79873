"""Quantiles from bounded storage against numpy's of all values."""

import math

import numpy as np
import pytest

from diffbot_bag.tools.quantiles import ACCURACY, Quantiles

RANDOM = np.random.default_rng(5)
SAMPLES = {
    "narrow": RANDOM.normal(3e6, 1e5, 30_000),
    "wide": RANDOM.lognormal(14.0, 3.0, 30_000),
    "both signs": RANDOM.normal(0.0, 1e7, 30_000),
    "negative": -RANDOM.lognormal(10.0, 1.0, 999),
    "with zeros": np.concatenate([np.zeros(500), RANDOM.exponential(1e5, 300)]),
    "small numbers": RANDOM.integers(-3, 4, 1000).astype(float),
    "two": np.array([5.0, 2e9]),
}


@pytest.mark.parametrize("name", SAMPLES)
@pytest.mark.parametrize("share", [0.0, 0.01, 0.5, 0.9, 0.99, 1.0])
def test_a_quantile_is_within_the_accuracy_of_the_exact_one(name, share):
    values = SAMPLES[name].astype(np.int64)
    quantiles = Quantiles()
    for part in np.array_split(values, 7):
        quantiles.add(part)
    exact = np.quantile(values, share, method="inverted_cdf")
    assert quantiles.quantile(share) == pytest.approx(exact, rel=ACCURACY, abs=0.0)
    assert (quantiles.count, quantiles.smallest, quantiles.largest) == (len(values), values.min(), values.max())


def test_equal_values_are_exact():
    quantiles = Quantiles()
    quantiles.add(np.full(9, 100_000_000))
    assert quantiles.quantile(0.99) == 100_000_000


def test_without_values_there_is_no_quantile():
    quantiles = Quantiles()
    quantiles.add(np.empty(0, np.int64))
    assert math.isnan(quantiles.quantile(0.5))


def test_storage_is_bounded_over_all_64_bit_numbers():
    quantiles = Quantiles()
    for _ in range(5):
        size = np.exp(RANDOM.uniform(0.0, 62.0 * math.log(2.0), 50_000))
        quantiles.add((size * RANDOM.choice((-1, 1), 50_000)).astype(np.int64))
    assert quantiles.count == 250_000
    assert len(quantiles._counts) < 44_000
