"""The benchmark of the calibration: its counts are those of the errors and deviations."""

import json
import math

import pytest

from diffbot_lab.filter_benchmark import calibration as benchmark
from diffbot_lab.filter_benchmark.calibration import NAMES, Found, results_of, run_and_report, table


def found(*z, nis=1.0):
    return Found(list(z), [0.1] * len(NAMES), 5.0, 1.02, nis, 0.03)


def test_counts_of_errors_inside_the_intervals():
    inside, outside = [1.9] * len(NAMES), [1.9, -2.0, math.inf, 0.0, 0.0, 0.0, 3.0]
    results = results_of([found(*inside), found(*outside, nis=1.04), found(*inside, nis=0.98)], 1)
    assert [one["inside"] for one in results["numbers"]] == [3, 2, 2, 3, 3, 3, 2]
    assert results["numbers"][3]["rms"] == pytest.approx(math.sqrt(2.0 * 1.9**2 / 3.0))
    assert results["nis_inside"] == 2
    low, high = results["numbers"][1]["interval"]
    # Wilson's interval of 2 of 3.
    assert (low, high) == pytest.approx((0.2077, 0.9385), abs=1e-4)
    assert "in 2 of 3 drives" in table(results)


def test_a_drive_is_calibrated_and_reported(tmp_path, monkeypatch):
    monkeypatch.setattr(benchmark, "SECONDS", 60.0)
    assert run_and_report(1, 1, tmp_path / "out") == 0
    results = json.loads((tmp_path / "out" / "results.json").read_text())
    assert results["runs"] == 1
    assert results["nis_before"] > 5.0
    assert results["nis_after"][0] == pytest.approx(1.0, abs=0.3)
    # Wrong by ten times what they state, the numbers would not be found at all.
    assert all(one["rms"] < 10.0 for one in results["numbers"])
    assert len((tmp_path / "out" / "table.md").read_text().splitlines()) == 2 + len(NAMES) + 2
