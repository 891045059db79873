"""The commands certify, verify and adversary of both laws from the command line."""

import json

import pytest
from certificates import LAW_17

from diffbot_lab.stability.adversary import command as adversary
from diffbot_lab.stability.paper import command
from diffbot_lab.stability.paper.file import load_certificate
from diffbot_tools import cli

SETTINGS = [
    *("k=1.5", "k_2=2.0", "eps_P=0.35", "eps_P_leave=0.4", "sampling_time=0.2"),
    *("eps_x_max=0.05", "eps_y_max=0.05", "eps_theta_max=0.05", "eps_v_max=0.02", "eps_omega_max=0.05"),
]
COARSE = ["--rho-max", "2", "--width", "0.05", "--columns", "80", "--threads", "1"]
SMALL = [
    *("--eps-position", "0.02", "--eps-theta", "0.01", "--sigma-max", "0.02"),
    *("--rho-max", "1.5", "--fineness", "0.4", "--margin", "1.0"),
]


def test_a_certificate_is_made_verified_and_attacked(tmp_path, capsys, monkeypatch):
    path, out = tmp_path / "one" / "c.json", tmp_path / "attack"
    assert cli.main(["stability", "certify", "--law", "17", *COARSE, "--out", str(path), "--set", *SETTINGS]) == 0
    made = capsys.readouterr().out
    certificate = load_certificate(path)
    assert certificate.loop == LAW_17
    printed = float(made.partition("r* = ")[2].split()[0])
    assert certificate.claims.radius <= printed < certificate.claims.radius + 1e-4
    assert f"({certificate.claims.steps} steps)" in made
    assert [one.name for one in path.parent.iterdir()] == ["c.json"]
    assert cli.main(["stability", "verify", str(path)]) == 0
    assert "Verified: " in capsys.readouterr().out
    monkeypatch.setattr(adversary, "_GENERATIONS", 1)
    arguments = ["stability", "adversary", str(path), "--steps", "5000", "--runs", "50", "--out", str(out)]
    assert cli.main(arguments) == 0
    found = json.loads((out / "adversary.json").read_text())
    assert found["observed"]["left_core"] == 0
    ratio = certificate.claims.radius / found["adversary"]["distance"]
    assert found["certified_over_adversary"] == ratio > 1.0
    assert (out / "adversary.png").stat().st_size > 10_000

    content = json.loads(path.read_text())
    content["claims"]["radius"] = 0.3
    path.write_text(json.dumps(content))
    assert cli.main(["stability", "verify", str(path)]) == 1
    error = capsys.readouterr().err.strip()
    assert error.startswith(f"diffbot: {path}: not verified: claims.radius = 0.3 m")


def test_a_certificate_of_the_tuned_law_is_made_and_verified(tmp_path, capsys):
    path = tmp_path / "new" / "tuned.json"
    assert cli.main(["stability", "certify", "--law", "tuned", *SMALL, "--out", str(path)]) == 0
    assert "not verified yet" in capsys.readouterr().out
    contract = {"eps_position": 0.02, "eps_theta": 0.01, "sigma_max": 0.02}
    contract |= {"wheel_error": 0.05, "eps_v": 0.0, "eps_omega": 0.0}
    expected = {"contract": contract, "period": 0.1, "to": 1.5, "margin": 1.0, "fineness": 0.4}
    assert json.loads(path.read_text())["plan"] == expected
    assert cli.main(["stability", "verify", str(path)]) == 0
    shown = capsys.readouterr().out
    assert "the estimate is within 0.02 m and 0.01 rad,\n  its standard deviation at most 0.02 m,\n" in shown
    assert "random steps keep to the ranks." in shown


@pytest.mark.parametrize(
    ("arguments", "status", "part"),
    [
        (["certify", "--law", "14"], 2, "--law"),
        (["certify", "--width", "0"], 2, "argument --width: 0: must be from"),
        (["certify", "--set", "drive_noise=0.1"], 1, "drive_noise = 0.1"),
        (["certify", "--rho-max", "0.5"], 1, "rho_max = 0.5: must be > 0.574 m"),
        (["certify", "--width", "0.0001", "--rho-max", "12"], 1, "width = 0.0001"),
        (["certify", "--width", "0.3", "--columns", "40", "--rho-max", "2"], 1, "no certificate"),
        (["certify", "--law", "tuned", "--width", "0.01"], 1, "--width = 0.01: must be left out with --law tuned"),
        (["certify", "--law", "17", "--margin", "0.1"], 1, "--margin = 0.1: must be left out with --law 17"),
        (["certify", "--law", "tuned", "--set", "command_latency=0.1"], 1, "eps_v = 0.0: must be above 0 with"),
        (["certify", "--law", "tuned", "--since", "5"], 1, "--since = 5.0: must be left out without --robot"),
        (["certify", "--robot", "tank"], 1, "robot = 'tank'"),
        (["verify", "absent.json"], 1, "cannot read absent.json"),
        (["adversary", "absent.json"], 1, "cannot read absent.json"),
    ],
)
def test_refused_in_one_line(arguments, status, part, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    try:
        found = cli.main(["stability", *arguments])
    except SystemExit as end:
        found = end.code
    assert found == status
    lines = capsys.readouterr().err.strip().splitlines()
    assert part in lines[-1]
    assert not list(tmp_path.rglob("*.json"))


def test_ctrl_c_leaves_nothing(tmp_path, monkeypatch):
    path = tmp_path / "new" / "c.json"
    parts = command.certify.__globals__["build_graph"].__globals__
    monkeypatch.setitem(parts, "_CELLS_AT_A_TIME", 400)
    real, done = parts["_part"], []

    def interrupted(loop, cells, first, last):
        if len(done) == 3:
            raise KeyboardInterrupt
        done.append(first)
        return real(loop, cells, first, last)

    monkeypatch.setitem(parts, "_part", interrupted)
    assert cli.main(["stability", "certify", *COARSE, "--out", str(path), "--set", *SETTINGS]) == 130
    assert not list(tmp_path.rglob("*.json*"))
