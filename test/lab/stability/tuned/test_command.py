"""``diffbot stability certify --law tuned`` and ``verify`` from the command line."""

import json

import pytest

from diffbot_tools import cli

CERTIFY = ["stability", "certify", "--law", "tuned"]
SMALL = [
    *("--eps-position", "0.02", "--eps-theta", "0.01", "--sigma-max", "0.02"),
    *("--rho-max", "1.5", "--fineness", "0.4", "--margin", "1.0"),
]


def test_a_certificate_is_made_and_verified(tmp_path, capsys):
    path = tmp_path / "new" / "tuned.json"
    assert cli.main([*CERTIFY, *SMALL, "--out", str(path)]) == 0
    assert "not verified yet" in capsys.readouterr().out
    assert json.loads(path.read_text())["plan"] == {
        "contract": {"eps_position": 0.02, "eps_theta": 0.01, "sigma_max": 0.02},
        "to": 1.5,
        "margin": 1.0,
        "fineness": 0.4,
    }
    assert cli.main(["stability", "verify", str(path)]) == 0
    shown = capsys.readouterr().out
    assert "errors within 0.02 m and 0.01 rad, sigma up to 0.02 m:" in shown
    assert "1000000 random steps keep to the ranks." in shown


@pytest.mark.parametrize(
    ("arguments", "status", "part"),
    [
        (["--width", "0.01"], 1, "--width = 0.01: must be left out with --law tuned"),
        (["--law", "17", "--margin", "0.1"], 1, "--margin = 0.1: must be left out with --law 17"),
        (["--set", "command_latency=0.1"], 1, "command_latency = 0.1: must be 0, for a certificate"),
    ],
)
def test_refused_in_one_line(arguments, status, part, tmp_path, capsys):
    path = tmp_path / "tuned.json"
    try:
        found = cli.main([*CERTIFY, "--out", str(path), *arguments])
    except SystemExit as end:
        found = end.code
    assert found == status
    assert part in capsys.readouterr().err.strip().splitlines()[-1]
    assert not path.exists()
