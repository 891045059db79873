"""How often a contract is kept: shares against arrays counted by hand, and ``diffbot stability contract``."""

import json
import math

import numpy as np
import pytest

from diffbot_lab.stability.contract import command
from diffbot_lab.stability.contract.kept import errors_within, holds_from, shares
from diffbot_lab.stability.tuned.contract import Contract
from diffbot_tools import cli


def test_a_contract_is_kept_by_hand_counted_steps_and_runs():
    errors = np.zeros((4, 10, 3))
    errors[0, 3, 0], errors[1, :5, 2], errors[2, 0] = 0.061, -0.031, (0.036, -0.047, 0.03)
    kept = shares(errors_within(errors, Contract()))
    assert kept.steps == pytest.approx((9 + 5 + 10 + 10) / 40)
    assert kept.runs == 0.5
    # Wilson's interval of 2 of 4, from the published formula: 0.5 -+ z sqrt(1/16 + z^2/64) / (1 + z^2/4) at z = 1.96.
    half = 1.96 * math.sqrt(0.25 / 4 + 1.96**2 / 64) / (1 + 1.96**2 / 4)
    assert (kept.runs_low, kept.runs_high) == pytest.approx((0.5 - half, 0.5 + half), abs=1e-4)
    # Half width: 1.96 standard deviations of the four shares over sqrt(4).
    half = 1.96 * np.std([0.9, 0.5, 1.0, 1.0], ddof=1) / 2.0
    assert kept.steps - kept.steps_low == pytest.approx(half, rel=1e-4)


def test_it_is_the_distance_that_is_bounded_and_no_estimate_is_no_kept_step():
    errors = np.array([[0.045, 0.045, 0.0], [0.0, -0.06, -0.03], [np.nan, np.nan, np.nan]])
    assert errors_within(errors, Contract()).tolist() == [False, True, False]


def test_the_contract_holds_from_the_step_after_the_last_break():
    kept = np.ones((4, 11), dtype=np.bool_)
    kept[1, [0, 3]], kept[2, 0], kept[3, 10] = False, False, False
    assert holds_from(kept, 0.5).tolist() == [0.0, 2.0, 0.5, math.inf]


def test_figures_are_those_of_the_windows():
    errors, sigma = np.ones((2, 601), dtype=np.bool_), np.ones((2, 601), dtype=np.bool_)
    errors[0, 100], sigma[1, 200:451], sigma[1, 600] = False, False, False
    found = command.figures(command.Observed(errors, sigma, 0.1))
    assert found["duration"] == 60.0
    by_window = {(one["from"], one["to"]): one for one in found["windows"]}
    assert [by_window[window]["errors"]["runs"] for window in command.WINDOWS] == [0.5, 0.5, 1.0, 1.0]
    assert by_window[5.0, 10.0]["errors"]["steps"] == pytest.approx(101 / 102)
    assert by_window[20.0, 45.0]["sigma"]["steps"] == 0.5
    assert by_window[10.0, 45.0]["all"]["runs"] == 0.0
    assert found["errors_hold_from"] == {"median": 0.0, "p95": pytest.approx(10.1), "not_at_end": 0}
    assert found["all_hold_from"] == {"median": pytest.approx(10.1), "p95": None, "not_at_end": 1}


def test_a_few_runs_make_results_and_tables(tmp_path, capsys):
    out = tmp_path / "new"
    assert cli.main(["stability", "contract", "--runs", "3", "--eps-position", "0.9", "--out", str(out)]) == 0
    shown = capsys.readouterr().out
    results = json.loads((out / "results.json").read_text())
    assert [path.name for path in out.iterdir()] == ["results.json"]
    assert results["contract"] == {"eps_position": 0.9, "eps_theta": 0.03, "sigma_max": 0.026}
    assert (results["seed"], results["filter"]) == (9017, "ekf_calibrating")
    assert [(case["name"], case["runs"]) for case in results["cases"]] == [(name, 3) for name in command.RUNS]
    assert len([line for line in shown.splitlines() if " to 45 s |" in line]) == 12
