"""The figures of the benchmarks show the runs, errors and names that they are given."""

import figures
import numpy as np
import pytest
from figures import drawn  # noqa: F401 - a fixture

from diffbot_lab.arena.entries import ENTRIES
from diffbot_lab.arena.report import figure as law_figure
from diffbot_sim.compiled.batch import COLUMNS

RUNS, STEPS = 4, 10


@pytest.fixture
def sheets():
    rng = np.random.default_rng(1)
    made = []
    for law in ENTRIES[:3]:
        outcomes = rng.uniform(0.01, 1.0, (RUNS, len(COLUMNS)))
        for name, missing in (("settling_time", 1), ("reached_time", 2)):
            times = (*rng.uniform(10.0, 50.0, RUNS - missing), *[np.nan] * missing)
            outcomes[:, COLUMNS.index(name)] = times
        made.append(law_figure.Sheet(law.name, law.label, outcomes, rng.normal(size=(RUNS, STEPS + 1, 3))))
    return made


@pytest.fixture
def law_axes(drawn, sheets):  # noqa: F811
    saved = drawn(law_figure)
    law_figure.draw_benchmark(sheets, None)
    return saved[0].axes


def test_the_curves_are_the_shares_of_all_runs(law_axes, sheets):
    labels = ("time of the answer [s]", "settling time [s]", "final position error [m]", "final heading error [rad]")
    for axes, label in zip(law_axes[3:], labels, strict=True):
        assert axes.get_xlabel() == label
        found = figures.lines(axes)
        for sheet in sheets:
            x, y, theta, settling, answer = (
                sheet.outcomes[:, COLUMNS.index(name)] for name in ("x", "y", "theta", "settling_time", "reached_time")
            )
            values = dict(zip(labels, (answer, settling, np.hypot(x, y), np.abs(theta)), strict=True))[label]
            values = values[np.isfinite(values)]
            curve = found[sheet.label].get_xydata()
            np.testing.assert_allclose(curve[:, 0], np.sort(values))
            # Of all runs, also of those that did not settle or were not answered.
            np.testing.assert_allclose(curve[:, 1], 100.0 * np.arange(1, len(values) + 1) / RUNS)
    assert law_axes[3].get_ylabel() == "share of all runs [%]"
