"""The docking benchmark: contacts of given histories, their figures, and a short run."""

import json
import math

import numpy as np
import pytest

from diffbot_lab.benchmark import docking as study
from diffbot_lab.laws.nav2_docking import Nav2Docking
from diffbot_sim import batch
from diffbot_sim.robot_step import EKF, FEEDBACKS
from diffbot_tools import cli

STEP = 0.1


def history(*rows):
    return np.array([rows], dtype=float)


def test_contact_is_interpolated_between_two_steps():
    rows = history((-0.3, 0.1, 0.0), (-0.03, 0.02, 3.13), (0.01, 0.06, -3.13), (0.02, 0.5, 0.5))
    # The contact is at three quarters between -0.03 and 0.01, and the heading crosses pi.
    heading = 3.13 + 0.75 * (2.0 * math.pi - 6.26)
    assert study.contacts(rows, STEP)[0] == pytest.approx((0.05, heading, 0.175, 0.4))


def test_contact_is_the_first_crossing_towards_the_dock():
    again = history((-0.1, 0.0, 0.0), (-0.2, 0.0, 0.0), (0.2, 0.1, 0.0), (-0.1, 0.0, 0.0), (0.1, 0.3, 0.0))
    out = history((0.1, 0.0, 0.0), (-0.1, 0.0, 0.0), (-0.2, 0.0, 0.0), (-0.1, 0.0, 0.0), (-0.05, 0.0, 0.0))
    both = study.contacts(np.concatenate([out, again]), STEP)
    assert np.isnan(both[0]).all()
    assert both[1] == pytest.approx((0.05, 0.0, 0.15, 4.0))


def test_figures_count_docked_beside_and_missed_runs():
    degree = math.radians(1.0)
    found = np.array(
        [
            (0.019, -1.9 * degree, 8.0, 0.1),
            (-0.005, 0.5 * degree, 9.0, 0.1),
            (-0.021, 0.0, 20.0, 0.1),
            (0.0, -2.1 * degree, 21.0, 0.1),
            (np.nan, np.nan, np.nan, np.nan),
        ]
    )
    figures = study.figures_of(found)
    assert [figures[name] for name in ("runs", "docked", "beside", "no_contact")] == [5, 2, 2, 1]
    assert figures["docked_interval"] == pytest.approx((0.1176, 0.7693), abs=1e-3)  # Wilson, 2 of 5
    assert figures["lateral"]["median"] == pytest.approx(0.012)
    assert figures["heading"]["max"] == pytest.approx(2.1 * degree)
    assert figures["time"]["median"] == pytest.approx(14.5)


def test_both_laws_receive_the_data_sheet_of_the_plant():
    base = study.case_of(study.CASES[0], study.Docking)
    assert base.robot.plant.command_delay == base.controller.drive.data_sheet.command_latency
    for law in study.LAWS.values():
        known = law.data_sheet(study.case_of(study.CASES[0], law).controller)
        assert known == study.Docking.data_sheet(base.controller)


@pytest.mark.study
def test_the_command_writes_results_that_do_not_depend_on_chunks(tmp_path, capsys, monkeypatch, kept_signal_handlers):
    # A few runs of the peer in plain Python take less time than its compilation.
    feedback = FEEDBACKS.index(EKF)
    monkeypatch.setitem(batch._kernels, (Nav2Docking, feedback), batch._make_fill(Nav2Docking, feedback))
    monkeypatch.setattr(study, "_CHUNK", 3)
    command = ["benchmark", "docking", "--runs", "5", "--seed", "9", "--out", str(tmp_path)]
    assert cli.main([*command, "--case", "docking", "--case", "docking_backward"]) == 0
    results = json.loads((tmp_path / "results.json").read_text())
    assert sorted(path.name for path in tmp_path.iterdir()) == ["docking.png", "results.json"]
    assert [row["name"] for row in results["cases"]] == ["docking", "docking_backward"]
    for row in results["cases"]:
        own, peer = row["laws"]["docking"], row["laws"]["nav2_docking"]
        assert own["docked"] == 5
        assert own["heading"]["median"] < peer["heading"]["median"]
        assert 0.05 < own["speed"]["median"] < 0.1 < peer["speed"]["p99"] < 0.15
    lines = capsys.readouterr().out.splitlines()
    assert sum("Nav2's docking server |" in line for line in lines) == 2
    # The results do not depend on the size of the chunks.
    starts = study.docking_starts(5, 9)
    monkeypatch.setattr(study, "_CHUNK", 500)
    found, paths = study.run_docking(study.CASES[0], study.Docking, starts, 9)
    assert study.figures_of(found) == results["cases"][0]["laws"]["docking"]
    np.testing.assert_array_equal(paths[:, 0], starts)
    # The paths of a robot that docks backwards are in the frame turned by pi.
    _, paths = study.run_docking(study.cases_named(("docking_backward",), study.CASES)[0], study.Docking, starts, 9)
    np.testing.assert_array_equal(paths[:, 0], starts)


def test_an_unknown_case_is_refused_before_the_runs(tmp_path, capsys, monkeypatch, kept_signal_handlers):
    monkeypatch.setattr(study, "run_docking", lambda *_: pytest.fail("ran"))
    assert cli.main(["benchmark", "docking", "--case", "sunny", "--out", str(tmp_path)]) == 1
    assert "case = 'sunny': must be one of docking, " in capsys.readouterr().err
