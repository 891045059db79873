"""The figures of the benchmarks show the runs, errors and names that they are given."""

import figures
import numpy as np
import pytest
from figures import drawn  # noqa: F401 - a fixture

from diffbot_control.filter.options import FILTERS
from diffbot_lab.benchmark import filter_figure, law_figure
from diffbot_lab.benchmark.filter_cases import RATES, SCENARIOS, name_of
from diffbot_lab.benchmark.law_entries import ENTRIES
from diffbot_sim.compiled.batch import COLUMNS

RUNS, STEPS = 4, 10


@pytest.fixture
def sheets():
    rng = np.random.default_rng(1)
    made = []
    for law in ENTRIES[:3]:
        outcomes = rng.uniform(0.01, 1.0, (RUNS, len(COLUMNS)))
        outcomes[:, COLUMNS.index("settling_time")] = (*rng.uniform(10.0, 50.0, RUNS - 1), np.nan)
        made.append(law_figure.Sheet(law.name, law.label, outcomes, rng.normal(size=(RUNS, STEPS + 1, 3))))
    return made


@pytest.fixture
def law_axes(drawn, sheets):  # noqa: F811
    saved = drawn(law_figure)
    law_figure.draw_benchmark(sheets, None)
    return saved[0].axes


def test_the_curves_are_the_shares_of_all_runs(law_axes, sheets):
    labels = ("settling time [s]", "final position error [m]", "final heading error [rad]")
    for axes, label in zip(law_axes[3:], labels, strict=True):
        assert axes.get_xlabel() == label
        found = figures.lines(axes)
        for sheet in sheets:
            x, y, theta, settling = (
                sheet.outcomes[:, COLUMNS.index(name)] for name in ("x", "y", "theta", "settling_time")
            )
            values = dict(zip(labels, (settling, np.hypot(x, y), np.abs(theta)), strict=True))[label]
            values = values[np.isfinite(values)]
            curve = found[sheet.label].get_xydata()
            np.testing.assert_allclose(curve[:, 0], np.sort(values))
            # Of all runs, also of those that did not settle.
            np.testing.assert_allclose(curve[:, 1], 100.0 * np.arange(1, len(values) + 1) / RUNS)
    assert law_axes[3].get_ylabel() == "share of all runs [%]"


@pytest.fixture
def results():
    rng = np.random.default_rng(2)
    cases = [
        {
            "name": name_of(one.name, *rates),
            "scenario": one.name,
            "odometry_rate": rates[0],
            "fix_rate": rates[1],
            "filters": {name: {"position": {"rmse": rng.uniform(0.02, 1.0)}} for name in FILTERS},
        }
        for one in SCENARIOS
        for rates in one.rates
    ]
    return {"cases": cases}


@pytest.fixture
def filter_axes(drawn, results):  # noqa: F811
    saved = drawn(filter_figure)
    filter_figure.draw_localization(results, {name: np.full((STEPS + 1, 4), 0.1) for name in FILTERS}, 0.1, None)
    return saved[0].axes


def test_each_bar_is_the_rmse_of_its_case_and_variant(filter_axes, results):
    for axes, rates in zip(filter_axes[len(FILTERS) :], RATES, strict=True):
        # The rates of the odometry have a table.
        shown = [one for one in results["cases"] if one["scenario"] != "rates"]
        cases = [one for one in shown if (one["odometry_rate"], one["fix_rate"]) == rates]
        for container, name in zip(axes.containers, FILTERS, strict=True):
            assert container.get_label() == name
            heights = [bar.get_height() for bar in container]
            assert heights == [one["filters"][name]["position"]["rmse"] for one in cases]
            centres = [bar.get_x() + 0.5 * bar.get_width() for bar in container]
            np.testing.assert_allclose(np.round(centres), np.arange(len(cases)))
        names = [text.get_text().replace("-\n", "").replace("\n", " ") for text in axes.get_xticklabels()]
        assert names[0] == "right model"
        assert len(names) == len(cases)
        assert [text.get_text() for text in axes.texts] == [f"odometry {rates[0]} Hz, fixes {rates[1]} Hz"]
