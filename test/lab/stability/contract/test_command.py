"""``diffbot stability contract``: a few runs, its figures and its tables."""

import json

import numpy as np
import pytest

from diffbot_lab.stability.contract import command
from diffbot_tools import cli


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
