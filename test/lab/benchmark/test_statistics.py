"""Statistics of given outcomes, and bootstrap intervals against resampling."""

import math

import numpy as np
import pytest

from diffbot_lab.benchmark.statistics import bootstrap_interval, figures_of, spread
from diffbot_sim.batch import COLUMNS


@pytest.mark.parametrize("level", [0.5, 0.95])
def test_the_bootstrap_interval_equals_the_interval_of_many_resamples(level):
    rng = np.random.default_rng(3)
    values = rng.gamma(2.0, 1.0, 400)
    resamples = np.sort(rng.choice(values, (20_000, 400)), axis=1)[:, math.ceil(level * 400) - 1]
    expected = np.quantile(resamples, (0.025, 0.975), method="inverted_cdf")
    found = bootstrap_interval(values, level)
    # The ends of the resampled interval vary by a rank or two.
    ranks = [np.searchsorted(np.sort(values), pair) for pair in (found, expected)]
    assert np.abs(ranks[0] - ranks[1]).max() <= 2


def test_one_value_is_its_own_interval():
    assert bootstrap_interval(np.array([2.0]), 0.99) == (2.0, 2.0)
    assert spread(np.empty(0))["median_interval"] is None


def test_the_statistics_of_four_given_runs():
    outcomes = np.zeros((4, len(COLUMNS)))
    column = {name: outcomes[:, index] for index, name in enumerate(COLUMNS)}
    column["x"][:] = (0.03, 0.06, 0.0, 0.3)
    column["y"][:] = (0.04, 0.08, 0.0, 0.4)
    column["theta"][:] = (-0.2, 0.1, 0.0, 0.3)
    column["settling_time"][:] = (117 * 0.1, 20.0, 10.0, math.nan)
    column["turning"][:] = (1.0, 2.0, 3.0 * math.pi, 3.1 * math.pi)
    column["reached_time"][:] = (12.0, math.nan, 13.0, 14.0)
    column["false_reached"][:] = (0.0, 0.0, 0.0, 1.0)
    figures = figures_of(outcomes)
    assert (figures["runs"], figures["settled"], figures["reached"], figures["false_reached"]) == (4, 3, 3, 1)
    # Wilson's interval of 3 in 4, from published tables.
    assert figures["settled_interval"] == pytest.approx([0.3006, 0.9544], abs=1e-4)
    assert figures["settling_time"]["median"] == 11.7  # not 11.700000000000001
    assert figures["settling_time"]["max"] == 20.0
    assert figures["position"]["median"] == pytest.approx(0.075)
    assert figures["position"]["max"] == pytest.approx(0.5)
    assert figures["heading"]["max"] == pytest.approx(0.3)
    assert figures["reached_time"]["median"] == 13.0
    assert figures["revolutions"] == pytest.approx(1.55)
    outcomes[:, 3] = math.nan
    assert figures_of(outcomes)["settling_time"]["p99"] is None
