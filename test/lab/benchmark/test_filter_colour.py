"""The benchmark of coloured fixes: its drives, its filters, and its tables."""

import copy
import json
import math
from pathlib import Path

import numpy as np
import pytest
from page_tables import assert_shows, assert_shows_targets, tables

from diffbot_core.errors import InvalidValueError
from diffbot_lab.benchmark.filter_colour import (
    GIVEN,
    OFF,
    ON,
    ColourRun,
    cells,
    figures_of,
    options_for,
    record_drive,
    run_benchmark,
    run_filter,
)
from diffbot_lab.benchmark.filter_colour_report import conclusions, page_part, table, targets

ROOT = Path(__file__).resolve().parents[3]


@pytest.fixture(scope="module")
def kept():
    return json.loads((ROOT / "docs/results/data/localization_colour.json").read_text())


@pytest.mark.parametrize("c", [0.0, 0.9])
def test_fixes_have_the_correlation_and_the_variance_of_the_case(c):
    errors = [
        [fix.pose.x - step.truth.x, fix.pose.y - step.truth.y]
        for step in record_drive(c, 3, 0, 400.0)
        for fix in step.measurements
    ]
    e = np.array(errors)
    assert len(e) == 2001  # 5 Hz, the first at 0 s
    assert np.mean(e[1:] * e[:-1]) / np.mean(e * e) == pytest.approx(c, abs=0.05)
    assert np.mean(e * e) == pytest.approx(0.3**2 / 3.0, rel=0.3)


def test_the_filters_differ_in_what_they_know_of_the_correlation():
    drive = record_drive(0.9, 3, 0)
    off, on, given = (run_filter(drive, options_for(mode, 0.9)) for mode in (OFF, ON, GIVEN))
    assert off.nees > 12.0
    assert max(on.nees, given.nees) < 6.0
    assert max(off.alarm, on.alarm) < 20.0
    assert math.isnan(given.alarm)
    # 5 Hz: 0.2 s between two fixes.
    assert math.exp(-0.2 / options_for(GIVEN, 0.9).fix_correlation_time) == pytest.approx(0.9)


def test_figures_are_those_of_the_runs():
    found = figures_of(0.9, ON, [ColourRun(2.0, 0.01, 3.0), ColourRun(4.0, 0.03, 9.0), ColourRun(3.0, 0.02, math.nan)])
    assert (found["c"], found["mode"], found["runs"], found["alarms"], found["alarm_median"]) == (0.9, ON, 3, 2, 6.0)
    assert found["nees"] == pytest.approx(3.0)
    assert found["rmse"] == pytest.approx(math.sqrt(0.02))
    assert figures_of(0.0, OFF, [ColourRun(2.0, 0.01, math.nan)])["alarm_median"] is None


def test_no_runs_are_refused():
    with pytest.raises(InvalidValueError, match="runs"):
        run_benchmark(0, 1)


def test_the_kept_results_are_complete_and_hold_their_conclusions(kept):
    assert [(one["c"], one["mode"]) for one in kept["cells"]] == cells()
    assert kept["targets"] == conclusions(kept)["targets"]
    assert {one["runs"] for one in kept["cells"]} == {kept["runs"]}


def test_each_target_follows_its_own_figure(kept):
    names = {(one.case, one.text) for one in targets(kept)}
    assert len(names) == 14
    for index, cell in enumerate(kept["cells"]):
        bad = copy.deepcopy(kept)
        bad["cells"][index] |= {"nees": 99.0, "alarms": kept["runs"] if cell["c"] == 0.0 else 0}
        before = {(one.case, one.text): one.met for one in targets(kept)}
        changed = {(one.case, one.text) for one in targets(bad) if one.met != before[one.case, one.text]}
        assert all(case == f"c = {cell['c']:g}, {cell['mode']}" for case, _ in changed)
        coloured = {OFF: 1, ON: 2, GIVEN: 1}[cell["mode"]]
        assert len(changed) == (1 if cell["c"] == 0.0 else coloured)


def test_every_number_of_the_page_is_that_of_the_results(kept):
    part = page_part(kept)
    assert part in (ROOT / "docs/results/filter/coloured.md").read_text()
    (_, *rows), goals = tables(part)
    assert_shows_targets(goals, kept["targets"])
    for row, one in zip(rows, kept["cells"], strict=True):
        share, interval = row[4].removesuffix(")").split(" (")
        assert float(row[0]) == one["c"]
        assert_shows([row[2], row[3], row[5]], [one["rmse"], one["nees"], one["alarm_median"]])
        assert_shows([share], [100.0 * one["alarms"] / one["runs"]])
        # Wilson's interval, as the roots of (p - share)^2 = z^2 p (1 - p) / n.
        n, p, z = one["runs"], one["alarms"] / one["runs"], 1.959964
        low, high = sorted(np.roots([1.0 + z * z / n, -2.0 * p - z * z / n, p * p]))
        assert_shows(interval.removesuffix(" %").split(" .. "), [100.0 * low, 100.0 * high])


def test_the_terminal_shows_what_is_missed(kept):
    bad = copy.deepcopy(kept)
    place = next(index for index, one in enumerate(bad["cells"]) if (one["c"], one["mode"]) == (0.9, ON))
    bad["cells"][place]["nees"] = 6.5
    assert "  missed: c = 0.9, on, mean NEES: 6.500, not <= 6" in table(bad).splitlines()
