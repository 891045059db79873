"""The benchmark of coloured fixes: its drives, its filters, and its tables."""

import math

import pytest

from diffbot_lab.filter_benchmark.colour import (
    GIVEN,
    OFF,
    ON,
    ColourRun,
    figures_of,
    options_for,
    record_drive,
    run_filter,
)


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
