"""The benchmark of the calibration: its counts are those of the errors and deviations."""

import json
import math

import pytest

from diffbot_lab.filter_benchmark import calibration as benchmark
from diffbot_lab.filter_benchmark.calibration import CASES, Found, results_of, run_and_report, table


def found(delay, factor):
    return Found({"odometry_delay": delay, "xy_factor": factor}, {"odometry_delay": 0.1, "xy_factor": 0.2}, 5.0, 1.02)


def test_counts_of_errors_inside_the_intervals():
    results = results_of([found(1.9, -2.0), found(-1.9, math.inf), found(1.9, 0.5)])
    assert [one["inside"] for one in results["numbers"]] == [3, 1]
    assert results["numbers"][0]["rms"] == pytest.approx(1.9)
    assert (results["inside"], results["of"]) == (4, 6)
    # Wilson's interval of 4 of 6.
    assert results["interval"] == pytest.approx((0.3000, 0.9032), abs=1e-4)
    assert "4 of 6: 66.7 % (30 .. 90)" in table({"cases": {"fixes": results}})


def test_a_drive_of_each_kind_is_calibrated_and_reported(tmp_path, monkeypatch):
    monkeypatch.setattr(benchmark, "SECONDS", 60.0)
    assert run_and_report(1, 3, tmp_path / "out") == 0
    results = json.loads((tmp_path / "out" / "results.json").read_text())
    assert list(results["cases"]) == list(CASES)
    for case in results["cases"].values():
        assert case["nis_before"] > 0.9
        # Wrong by ten times what they state, the numbers would not be found at all; inf is one that was not found.
        assert all(one["rms"] < 10.0 for one in case["numbers"])
        assert case["nis_held_out"][0] == pytest.approx(1.0, abs=0.5)
