"""The command ``diffbot stability picture``: what it writes, and what it refuses."""

import json
import math

import numpy as np
import pytest

from diffbot_control.law.lyapunov_law import PAPER_GAINS
from diffbot_control.law.presets import PAPER, PRESETS
from diffbot_core.errors import InvalidValueError
from diffbot_lab import cli
from diffbot_lab.stability.picture import command
from diffbot_lab.stability.picture.grid import evaluate_grid
from diffbot_lab.stability.settings import NoiseBox

PAPER_BOX = NoiseBox(0.3, 0.3, 0.17, 0.065, 0.2167)
T_S = 0.1
PNG = b"\x89PNG\r\n\x1a\n"


def test_what_is_written(tmp_path, capsys):
    out = tmp_path / "new" / "folder"
    assert cli.main(["stability", "picture", "--points", "21", "--runs", "500", "--seed", "3", "--out", str(out)]) == 0
    assert sorted(path.name for path in out.iterdir()) == ["picture.json", "picture.png"]
    assert (out / "picture.png").read_bytes().startswith(PNG)
    content = json.loads((out / "picture.json").read_text())
    assert content["noise"] == pytest.approx(PAPER_BOX._asdict())
    assert content["gains"] == PAPER_GAINS._asdict()
    computed, observed = content["at_grid_points"], content["only_observed"]
    direct = evaluate_grid(PRESETS[PAPER], PAPER_BOX, T_S, 12.0, 21)
    assert computed == {name: value for name, value in direct.items() if name != "maps"}
    assert computed["grid_points"] == 21**3
    assert computed["radius_condition"] == pytest.approx(0.474264, abs=1e-6)
    assert computed["heading_bound_local"] == pytest.approx(0.17 + 0.2167 / 2.7)
    assert (observed["runs"], observed["seed"]) == (500, 3)
    assert observed["position"]["median"] < observed["position"]["q99"] <= observed["position"]["max"]
    assert observed["position"]["max"] < computed["distance_of_level"]
    text = capsys.readouterr().out
    assert "> 0.4743 m: met" in text
    assert f"a distance of {computed['distance_of_level']:.3f} m" in text
    assert ("beyond the grid" in text) == (not computed["inside_grid"])


def test_a_bound_beyond_the_grid_is_marked(tmp_path, capsys):
    assert (
        cli.main(["stability", "picture", "--points", "11", "--runs", "10", "--rho-max", "2", "--out", str(tmp_path)])
        == 0
    )
    assert "which is beyond the grid" in capsys.readouterr().out
    assert json.loads((tmp_path / "picture.json").read_text())["at_grid_points"]["inside_grid"] is False


def test_a_small_radius_is_not_met(tmp_path, capsys):
    settings_ = ["--set", "eps_P=0.4", "eps_P_leave=0.5", "k_2=3"]
    assert cli.main(["stability", "picture", "--points", "11", "--runs", "10", *settings_, "--out", str(tmp_path)]) == 0
    assert "eps_P = 0.4 m against the paper's condition > 0.4743 m: NOT met" in capsys.readouterr().out
    assert json.loads((tmp_path / "picture.json").read_text())["gains"]["k_2"] == 3.0


def test_extreme_values_are_drawn_and_written_as_json(tmp_path):
    values = {
        "k_2": 25.0,
        "eps_x_max": 0.0,
        "eps_y_max": 0.0,
        "eps_theta_max": 0.0,
        "eps_v_max": 0.0,
        "eps_omega_max": 0.0,
    }
    assert command.run(values, 5.0, 11, 10, 1, tmp_path) == 0
    assert (tmp_path / "picture.png").read_bytes().startswith(PNG)

    def refuse(text):
        raise AssertionError(text)

    json.loads((tmp_path / "picture.json").read_text(), parse_constant=refuse)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("angular.z.max_velocity", 1.0),
        ("wheel.max_velocity", 5.0),
        ("wheel_acceleration_max", 5.0),
        ("left_radius_error", 0.1),
        ("slip_left", 0.5),
        ("fix_outlier", 0.1),
        ("fix_rate", 2.0),
    ],
)
def test_parameters_that_the_picture_does_not_cover_are_refused(name, value, tmp_path):
    with pytest.raises(InvalidValueError, match=f"{name} = {value}"):
        command.run({name: value}, 5.0, 11, 10, 1, tmp_path)


def test_observed_is_the_law_without_limits(tmp_path, monkeypatch):
    calls = []
    run_batch = command.run_batch
    monkeypatch.setattr(command, "run_batch", lambda *arguments: calls.append(arguments) or run_batch(*arguments))
    monkeypatch.setattr(command, "_RUNS_AT_A_TIME", 7)
    command.run({"gamma": 2.0}, 5.0, 11, 20, 1, tmp_path)
    assert [arguments[3:5] for arguments in calls] == [(0, 7), (7, 7), (14, 6)]
    case = calls[0][0]
    assert case.controller.gains.gamma == 2.0
    assert set(case.controller.data_sheet[:5]) == {math.inf}
    ends = run_batch(case, calls[0][1], 1, 0, 20)
    observed = json.loads((tmp_path / "picture.json").read_text())["only_observed"]
    assert observed["position"]["max"] == np.hypot(ends[:, 0], ends[:, 1]).max()
    assert observed["abs_theta"]["median"] == pytest.approx(np.median(np.abs(ends[:, 2])))


@pytest.mark.parametrize(
    ("arguments", "status", "part"),
    [
        (["--rho-max", "0"], 2, "argument --rho-max: 0: must be from"),
        (["--rho-max", "-3"], 2, "argument --rho-max: -3: must be from"),
        (["--rho-max", "nan"], 2, "argument --rho-max: nan: must be from"),
        (["--rho-max", "inf"], 2, "argument --rho-max: inf: must be from"),
        (["--rho-max", "far"], 2, "--rho-max"),
        (["--points", "10"], 2, "--points"),
        (["--points", "402"], 2, "--points"),
        (["--runs", "0"], 2, "--runs"),
        (["--seed", "-1"], 2, "--seed"),
        (["--set", "kk=1"], 1, "kk = 1"),
        (["--set", "k=-1"], 1, "k = -1.0"),
        (["--set", "k=.nan"], 1, "k = nan"),
        (["--set", "k=fast"], 1, "k = 'fast'"),
        (["--set", "k"], 2, "NAME=VALUE"),
        (["--set", "k=1", "k=2"], 1, "--set k = 2"),
        (["--set", "eps_P=0.9"], 1, "eps_P_leave"),
        (["--set", "fix_delay=0.5"], 1, "fix_delay = 0.5"),
    ],
)
def test_refused_in_one_line(arguments, status, part, tmp_path, capsys):
    out = tmp_path / "out"
    try:
        found = cli.main(["stability", "picture", "--points", "11", "--runs", "5", "--out", str(out), *arguments])
    except SystemExit as end:
        found = end.code
    assert found == status
    lines = capsys.readouterr().err.strip().splitlines()
    assert part in lines[-1]
    assert status == 2 or len(lines) == 1
    assert not out.exists()


def test_an_impossible_folder_is_one_line(tmp_path, capsys):
    (tmp_path / "file").write_text("mine")
    for out in (tmp_path / "file", tmp_path / "file" / "out"):
        assert cli.main(["stability", "picture", "--points", "11", "--runs", "5", "--out", str(out)]) == 1
        error = capsys.readouterr().err
        assert error.startswith("diffbot: cannot write to ")
        assert error.count("\n") == 1
