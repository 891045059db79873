"""Statistics of campaigns equal scipy's and numpy's, and do not depend on the order."""

import itertools
import json
import math
from collections import Counter

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from diffbot_lab.campaign.statistics import (
    BIN_WIDTH,
    METRICS,
    QUANTILES,
    CellStatistics,
    bins_of,
    count_outcomes,
    quantile,
)
from diffbot_sim.batch import COLUMNS

NAN, INF = math.nan, math.inf


@pytest.mark.parametrize("value", [INF, 1e303])
def test_huge_and_infinite_values_count_as_the_largest(value):
    # Without a warning, which would be an error here.
    bins = Counter(bins_of(np.array([1.0, value])))
    assert quantile(bins, 0.5) == pytest.approx(1.0, rel=BIN_WIDTH)
    assert quantile(bins, 1.0) == pytest.approx(1e300, rel=BIN_WIDTH)


def outcomes_of(**columns):
    number = len(next(iter(columns.values())))
    table = np.zeros((number, len(COLUMNS)))
    for name, values in columns.items():
        table[:, COLUMNS.index(name)] = values
    return table


def statistics_of(*tables):
    found = CellStatistics()
    for one in tables:
        found.add(json.loads(json.dumps(count_outcomes(one))))
    return found


def test_the_summary_equals_numpys_quantiles_and_counts():
    rng = np.random.default_rng(1)
    table = rng.lognormal(0.0, 2.0, (10_000, len(COLUMNS)))
    table[:, COLUMNS.index("switches")] = rng.integers(0, 150, 10_000)
    for name, share in (("settling_time", 0.3), ("local_time", 0.2), ("estimation_error", 0.1)):
        table[rng.random(10_000) < share, COLUMNS.index(name)] = NAN
    column = {name: table[:, index] for index, name in enumerate(COLUMNS)}
    values = {
        **column,
        "position_error": np.hypot(column["x"], column["y"]),
        "heading_error": np.abs(column["theta"]),
        "settling_time": column["settling_time"][np.isfinite(column["settling_time"])],
    }
    summary = statistics_of(table).summary()
    settled = len(values["settling_time"])
    assert summary["runs"] == 10_000
    assert summary["success_rate"] == settled / 10_000
    # Wilson's formula.
    z, share = stats.norm.ppf(0.975), settled / 10_000
    centre, scale = share + z**2 / 20_000, 1.0 + z**2 / 10_000
    half = z * math.sqrt(share * (1.0 - share) / 10_000 + (z / 20_000) ** 2)
    interval = (centre - half) / scale, (centre + half) / scale
    assert (summary["success_low"], summary["success_high"]) == pytest.approx(interval)
    assert summary["reached_local_region"] == np.isfinite(column["local_time"]).sum()
    for metric, q in itertools.product(METRICS, QUANTILES):
        sample = values[metric][~np.isnan(values[metric])]
        expected = np.quantile(sample, q, method="inverted_cdf")
        tolerance = {"abs": 0.0} if metric == "switches" else {"rel": 0.5 * BIN_WIDTH + 1e-9}
        assert summary[f"{metric}_q{100 * q:g}"] == pytest.approx(expected, **tolerance), (metric, q)


def test_tiny_values_count_as_zero_and_nan_is_ignored():
    bins = bins_of(np.array([0.0, -0.0, 5e-324, 0.99e-6, NAN]))
    assert sum(bins.values()) == 4
    assert quantile(Counter(bins), 1.0) == 0.0
    assert math.isnan(quantile(Counter(), 0.5))


@given(st.lists(st.lists(st.just(0.0) | st.just(NAN) | st.floats(0.0, 1e12), min_size=1, max_size=8), min_size=1))
def test_results_do_not_depend_on_order_and_chunks(chunks):
    tables = [outcomes_of(settling_time=chunk, effort=chunk) for chunk in chunks]
    forth, back = statistics_of(*tables), statistics_of(*reversed(tables))
    together = statistics_of(np.concatenate(tables))
    assert json.dumps(forth.summary()) == json.dumps(back.summary()) == json.dumps(together.summary())
    assert forth.ecdf("effort") == together.ecdf("effort")


def test_missing_values_give_none():
    found = statistics_of(outcomes_of(settling_time=[NAN, NAN], estimation_error=[NAN, NAN], local_time=[NAN, 3.0]))
    summary = found.summary()
    names = ("success_rate", "settling_time_q50", "estimation_error_q99", "reached_local_region", "position_error_q50")
    assert [summary[name] for name in names] == [0.0, None, None, 1, 0.0]
    assert found.ecdf("settling_time") == ([], [])
    json.dumps(summary, allow_nan=False)


def test_the_distribution_equals_scipys_and_includes_runs_that_did_not_settle():
    effort = np.random.default_rng(1).lognormal(0.0, 2.0, 5000)
    values, shares = statistics_of(outcomes_of(effort=effort)).ecdf("effort")
    assert values == sorted(values)
    assert shares[-1] == 1.0
    # At the upper end of each bin the count is exact.
    ends = [value * (1.0 + BIN_WIDTH) ** 0.5 for value in values]
    assert shares == pytest.approx(stats.ecdf(effort).cdf.evaluate(np.array(ends)), abs=1e-12)
    values, shares = statistics_of(outcomes_of(settling_time=[1.0, NAN, 2.0, NAN])).ecdf("settling_time")
    assert values == pytest.approx([1.0, 2.0], rel=BIN_WIDTH)
    assert shares == [0.25, 0.5]
