"""The readings of the paper's simulation A: against a plain numpy simulation, and the command."""

import json
import math

import numpy as np
import pytest

from diffbot_lab.campaign.statistics import wilson
from diffbot_lab.paper import scan
from diffbot_lab.paper.scan import READINGS, is_in_box, is_near_goal, run_ends, table
from diffbot_tools import cli

RUNS = 2000
SHARE_OF_NOISE = {"raw": np.ones_like, "vanishing": lambda rho: np.minimum(rho, 1.0), "heading only": np.zeros_like}


def wrapped(angles):
    return math.pi - np.remainder(math.pi - angles, 2.0 * math.pi)


def textbook(share_of_noise, eps_P, runs):
    """Simulation A: 30 s of law (17), Euler's step, noise of numpy; end poses and v over the last 10 s."""
    rng = np.random.default_rng(99)
    x, y, theta = (np.full(runs, value) for value in (-2.0, -5.5, math.pi / 6.0))
    speeds = []
    for _ in range(300):
        noise = rng.uniform(-1.0, 1.0, (5, runs))
        share = share_of_noise(np.hypot(x, y))
        seen_x, seen_y = x + 0.3 * share * noise[0], y + 0.3 * share * noise[1]
        seen_theta = wrapped(theta + 0.17 * noise[2])
        rho, beta = np.hypot(seen_x, seen_y), np.arctan2(-seen_y, -seen_x)
        alpha = wrapped(beta - seen_theta)
        v = 1.3 * np.tanh(rho) * np.cos(alpha)
        far = alpha + v * np.sinc(alpha / math.pi) / rho * (alpha + 0.17 * beta)
        omega = np.where(rho < eps_P, -2.7 * seen_theta, far)
        x = x + 0.1 * (v + 0.065 * noise[3]) * np.cos(theta)
        y = y + 0.1 * (v + 0.065 * noise[3]) * np.sin(theta)
        theta = wrapped(theta + 0.1 * (omega + 0.2167 * noise[4]))
        speeds.append(v)
    return np.column_stack((x, y, theta)), np.std(speeds[-100:], axis=0)


@pytest.mark.parametrize("reading", READINGS, ids=[one.name for one in READINGS])
@pytest.mark.parametrize(("law", "eps_P"), [("law 13", 0.0), ("law 17", 0.25)])
def test_runs_end_like_a_plain_simulation(reading, law, eps_P):
    ours = run_ends(law, reading._replace(eps_P=eps_P), RUNS, 7)
    poses, deviations = textbook(SHARE_OF_NOISE[reading.name], eps_P, RUNS)
    assert np.median(np.abs(ours.poses[:, 1])) == pytest.approx(np.median(np.abs(poses[:, 1])), rel=0.05, abs=5e-4)
    assert np.median(ours.deviations) == pytest.approx(np.median(deviations), rel=0.05)
    agrees = is_near_goal if law == "law 13" else is_in_box
    one, other = agrees(ours.poses).mean(), agrees(poses).mean()
    assert abs(one - other) < 4.0 * math.sqrt(2.0 * 0.25 * max(one, 0.01) / RUNS * 4.0)


def test_an_end_is_near_the_papers_in_magnitude():
    poses = np.array(
        [
            (0.0028, 0.1049, 0.0066),
            (-0.0227, -0.1248, -0.0265),
            (0.0229, 0.1049, 0.0066),
            (0.0028, 0.1250, 0.0066),
            (0.0028, 0.0848, 0.0066),
            (0.0028, 0.1049, 0.0267),
        ]
    )
    assert is_in_box(poses).tolist() == [True, True, False, False, False, False]
    radius = math.hypot(0.0071, 0.0097)
    assert is_near_goal(radius * np.array([(0.6, 0.799, 3.0), (0.0, -1.001, 0.0)])).tolist() == [True, False]


def test_ends_do_not_depend_on_the_parts_they_are_run_in(monkeypatch):
    whole = run_ends("law 17", READINGS[1], 7, 3)
    monkeypatch.setattr(scan, "_RUNS_AT_A_TIME", 3)
    for one, other in zip(whole, run_ends("law 17", READINGS[1], 7, 3), strict=True):
        np.testing.assert_array_equal(one, other)


def test_the_command_writes_shares_with_their_intervals(tmp_path, capsys):
    assert cli.main(["experiment", "scan", "--runs", "40", "--out", str(tmp_path)]) == 0
    results = json.loads((tmp_path / "scan" / "results.json").read_text())
    assert (results["runs"], results["seed"]) == (40, 2)
    assert [one["reading"] for one in results["law 13"]] == ["raw", "vanishing", "heading only"]
    assert {one["eps_P"] for one in results["law 17"]} >= {0.1, 0.25, 0.5}
    for one in results["law 13"] + results["law 17"]:
        count = round(40 * one["agree"])
        assert one["agree_interval"] == pytest.approx(wilson(count, 40))
    cell = next(one for one in results["law 17"] if (one["reading"], one["eps_P"]) == ("vanishing", 0.25))
    ends = run_ends("law 17", READINGS[1], 40, 2)
    assert cell["agree"] == is_in_box(ends.poses).mean()
    assert cell["positive_y"] == (ends.poses[:, 1] > 0.0).mean()
    assert cell["median_abs_y"] == np.median(np.abs(ends.poses[:, 1]))
    assert cell["median_sd_v"] == np.median(ends.deviations)
    assert capsys.readouterr().out.strip().endswith(f"eps_P of law 17: as in the row\n{table(results)}")
