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


def test_each_law_has_a_panel_of_its_paths(law_axes, sheets):
    for axes, sheet in zip(law_axes[:3], sheets, strict=True):
        assert axes.get_title().replace("\n", " ") == sheet.label
        paths = [line.get_xydata() for line in axes.lines if len(line.get_xydata()) == STEPS + 1]
        np.testing.assert_array_equal(paths, sheet.paths[:, :, :2])
    assert (law_axes[0].get_xlabel(), law_axes[0].get_ylabel()) == ("x [m]", "y [m]")


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
def histories():
    rng = np.random.default_rng(3)
    return {name: rng.uniform(0.01, 0.5, (STEPS + 1, 4)) for name in FILTERS}


@pytest.fixture
def filter_axes(drawn, results, histories):  # noqa: F811
    saved = drawn(filter_figure)
    filter_figure.draw_localization(results, histories, 0.1, None)
    return saved[0].axes


def test_each_variant_has_a_panel_of_its_error_and_three_deviations(filter_axes, histories):
    for axes, name in zip(filter_axes[: len(FILTERS)], FILTERS, strict=True):
        assert axes.get_title() == name
        time = 0.1 * np.arange(STEPS + 1)
        error = figures.lines(axes)["error"].get_xydata()
        np.testing.assert_allclose(error, np.column_stack([time, histories[name][:, 0]]))
        (band,) = axes.collections
        outline = band.get_paths()[0].vertices
        highest = [outline[np.isclose(outline[:, 0], at), 1].max() for at in time]
        np.testing.assert_allclose(highest, 3.0 * histories[name][:, 2])


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
