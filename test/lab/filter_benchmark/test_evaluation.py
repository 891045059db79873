"""The figures of the filter's benchmark, from rows made by hand."""

import json
import math

import numpy as np
import pytest
from scipy import stats

from diffbot_lab.filter_benchmark.command import COLUMNS, figures_of


def rows(**columns):
    count = max(len(values) for values in columns.values())
    trackings = np.zeros((count, len(COLUMNS)))
    trackings[:, COLUMNS.index("back")] = math.nan
    trackings[:, COLUMNS.index("fixes")] = 10.0
    for name, values in columns.items():
        trackings[:, COLUMNS.index(name)] = values
    return trackings


def test_figures_by_hand():
    found = figures_of(
        rows(
            position=(0.3, 0.4, 0.0, 0.0),
            heading=(0.01, 0.02, 0.03, 0.04),
            largest=(1.0, 4.0, 2.0, 0.1),
            end=(0.5, 0.51, math.nan, 0.0),
            back=(1.0, 2.0, 28 * 0.1, 9.0),
            nis=(3.0, 6.0, 2.0, 3.0),
            innovations=(100, 50, 50, 200),
            nees=(1.0, 2.0, 3.0, 8.0),
            fixes=(100, 60, 50, 190),
            rejected=(1, 2, 0, 1),
            relocated=(0, 3, 0, 0),
        )
    )
    assert found["runs"] == 4
    assert found["position"] == {
        "rmse": pytest.approx(0.25),
        "median": pytest.approx(0.15),
        "p95": pytest.approx(0.385),
    }
    assert found["heading"]["rmse"] == pytest.approx(0.01 * math.sqrt(7.5))
    assert found["largest"] == 4.0
    assert figures_of(rows(back=(28 * 0.1,)))["back_max"] == 2.8  # not 2.8000000000000003
    assert found["lost"] == 2  # one has no error at all
    assert (found["back_median"], found["back_max"]) == (2.4, 9.0)
    assert found["nis"] == pytest.approx((300 + 300 + 100 + 600) / 400)
    assert found["nis_low"] == pytest.approx(stats.chi2.ppf(0.025, 1200) / 400)
    assert found["nis_high"] == pytest.approx(stats.chi2.ppf(0.975, 1200) / 400)
    bounds = [stats.chi2.ppf((0.025, 0.975), 3 * n) / n for n in (100, 50, 50, 200)]
    inside = [low <= nis <= high for nis, (low, high) in zip((3.0, 6.0, 2.0, 3.0), bounds, strict=True)]
    assert inside == [True, False, False, True]
    assert found["nis_inside"] == 0.5
    assert found["nees"] == 3.5
    assert found["nees_low"] == pytest.approx(stats.chi2.ppf(0.025, 12) / 4)
    assert found["nees_high"] == pytest.approx(stats.chi2.ppf(0.975, 12) / 4)
    assert found["rejected"] == pytest.approx(0.01)
    assert found["relocations"] == 0.75


def test_figures_without_samples_are_null():
    found = figures_of(rows(position=(0.1, 0.1), nis=(math.nan, math.nan)))
    none = {"back_median", "back_max", "nis", "nis_low", "nis_high", "nis_inside"}
    assert {key for key, value in found.items() if value is None} == none
    json.dumps(found, allow_nan=False)
