"""The commands certify, verify and adversary from the command line."""

import json

import pytest

from diffbot_lab.stability import adversary, certificates
from diffbot_lab.stability.file import load_certificate
from diffbot_lab.stability.plan import Contract
from diffbot_tools import cli

SMALL = [
    *("--eps-position", "0.02", "--eps-theta", "0.01", "--sigma-max", "0.02"),
    *("--sigma-slope", "0.001", "--rho-max", "1.5", "--fineness", "0.4", "--margin", "1.0"),
]


def test_a_certificate_is_made_verified_and_attacked(tmp_path, capsys, monkeypatch):
    path, out = tmp_path / "new" / "one.json", tmp_path / "attack"
    monkeypatch.setattr(certificates, "_RANDOM_STEPS", 20_000)
    monkeypatch.setattr(adversary, "_GENERATIONS", 1)
    monkeypatch.setattr(adversary, "_POPULATION", 4)
    assert cli.main(["stability", "certify", *SMALL, "--out", str(path)]) == 0
    made = capsys.readouterr().out
    certificate = load_certificate(path)
    printed = float(made.partition("r* = ")[2].split()[0])
    assert certificate.claims.radius <= printed < certificate.claims.radius + 1e-4
    content = json.loads(path.read_text())
    given = {"eps_position": 0.02, "eps_theta": 0.01, "sigma_max": 0.02, "sigma_slope": 0.001}
    assert content["plan"] == {
        "contract": Contract(**given)._asdict(), "period": 0.1, "to": 1.5, "margin": 1.0, "fineness": 0.4,
    }  # fmt: skip
    assert cli.main(["stability", "verify", str(path)]) == 0
    shown = capsys.readouterr().out
    assert "estimate are at most 0.02 m and 0.01 rad,\n  its standard deviation is at most 0.02 m,\n" in shown
    assert "each bound grows by 0 m, 0 rad and 0.001 m per metre from the goal" in shown
    assert "decreases as certified in " in shown
    arguments = ["stability", "adversary", str(path), "--steps", "5000", "--runs", "50", "--out", str(out)]
    assert cli.main(arguments) == 0
    found = json.loads((out / "adversary.json").read_text())
    assert found["observed"]["left_core"] == 0
    ratio = certificate.claims.radius / found["adversary"]["distance"]
    assert found["certified_over_adversary"] == ratio > 1.0

    content["claims"]["radius"] = 0.3
    path.write_text(json.dumps(content))
    assert cli.main(["stability", "verify", str(path)]) == 1
    error = capsys.readouterr().err.strip()
    assert error.startswith(f"diffbot: {path}: not verified: claims.radius = 0.3 m")


@pytest.mark.parametrize(
    ("arguments", "status", "part"),
    [
        (["certify", "--period", "0"], 2, "argument --period: 0: must be from"),
        (["certify", "--set", "drive_noise=0.1"], 1, "drive_noise = 0.1"),
        (["certify", *SMALL, "--out", "."], 1, "--out = '.': must be the path of a file"),
        (["certify", "--sigma-slope", "0.5"], 1, "position_slope + 3 * sigma_slope = 1.5: must be below 1"),
        (["certify", "--since", "5"], 1, "--since = 5.0: must be left out without --robot"),
        (["certify", "--robot", "turtlebot4", "--rho-max", "5"], 1, "--rho-max = 5.0: must be left out with --robot"),
        (["verify", "absent.json"], 1, "cannot read absent.json"),
    ],
)
def test_invalid_options_end_in_one_line(arguments, status, part, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    try:
        found = cli.main(["stability", *arguments])
    except SystemExit as end:
        found = end.code
    assert found == status
    lines = capsys.readouterr().err.strip().splitlines()
    assert part in lines[-1]
    assert not list(tmp_path.rglob("*.json"))
