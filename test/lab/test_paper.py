"""The paper's experiments: settings, results, figures and command."""

import json
import math
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import pytest

from diffbot_control.law.paper import PaperLaw
from diffbot_core.errors import InvalidValueError
from diffbot_lab.paper import experiment
from diffbot_lab.paper import figures as paper_figures
from diffbot_lab.paper.experiment import (
    HEADINGS_B,
    PAPER_END_STATES,
    QUANTILES,
    SETTINGS,
    case_of,
    run_experiment,
    starts_of,
    summarise,
)
from diffbot_sim.batch import run_histories
from diffbot_tools import cli

RAW, EKF, _, VANISHING = SETTINGS
PUBLISHED = json.loads((Path(__file__).parents[2] / "docs/results/data/reproduction.json").read_text())


def wrapped(angles):
    return math.pi - np.remainder(math.pi - np.asarray(angles), 2.0 * math.pi)


@pytest.fixture(scope="module")
def groups():
    """Groups of each experiment by label, with the setting ``raw`` only."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(experiment, "SETTINGS", (RAW,))
        return {name: {one.label: one for one in run_experiment(name, 12, 1)} for name in ("a", "b")}


def test_the_settings_are_the_papers(groups):
    assert case_of("law 17", RAW).steps * RAW.plant.sampling_time == pytest.approx(30.0)
    assert case_of("law 17", RAW).goal == (0.0, 0.0, 0.0)
    a = groups["a"]["law 17"].histories
    assert (a[:, 0, :3] == [-2.0, -5.5, math.pi / 6.0]).all()
    for heading, label in zip(HEADINGS_B, ("heading 0 deg", "heading 220 deg"), strict=True):
        first = groups["b"][label].histories[:8, 0, :3]
        angles = np.radians(45.0 * np.arange(8))
        assert first[:, :2] == pytest.approx(12.0 * np.column_stack([np.cos(angles), np.sin(angles)]), abs=1e-12)
        assert wrapped(first[:, 2] - math.radians(heading)) == pytest.approx(np.zeros(8), abs=1e-12)
    errors = a[:, :, 3:6] - a[:, :, :3]
    for error, bound in zip((errors[..., 0], errors[..., 1], wrapped(errors[..., 2])), (0.3, 0.3, 0.17), strict=True):
        assert 0.99 * bound < np.abs(error).max() <= bound
        assert error.std() == pytest.approx(bound / math.sqrt(3.0), rel=0.03)
    # Invert Euler's step (3) between rows: the difference to the command is the input noise.
    moved = np.diff(a[:, :, :2], axis=1)
    theta = a[:, :-1, 2]
    v = (moved[..., 0] * np.cos(theta) + moved[..., 1] * np.sin(theta)) / 0.1
    omega = wrapped(np.diff(a[:, :, 2], axis=1)) / 0.1
    assert np.abs(moved[..., 1] * np.cos(theta) - moved[..., 0] * np.sin(theta)).max() < 1e-12
    for noise, bound in ((v - a[:, :-1, 6], 0.065), (omega - a[:, :-1, 7], 0.2167)):
        assert 0.99 * bound < np.abs(noise).max() <= bound + 1e-9
        assert noise.std() == pytest.approx(bound / math.sqrt(3.0), rel=0.03)


def test_with_the_printed_sign_the_robot_drives_away_from_a_goal_behind_it():
    case, printed = case_of("law 17", RAW), case_of("law 17", RAW, literal_rear=True)
    ours, theirs = (run_histories(one, starts_of("b", 0.0), 1, 0, 8, law=PaperLaw) for one in (case, printed))
    x = starts_of("b", 0.0).poses[:, 0]
    front, behind = x < -1e-9, x > 1e-9
    assert (front.sum(), behind.sum()) == (3, 3)
    np.testing.assert_array_equal(ours[front, 0, 6], theirs[front, 0, 6])
    np.testing.assert_array_equal(ours[behind, 0, 6], -theirs[behind, 0, 6])
    np.testing.assert_array_equal(ours[:, 0, 7], theirs[:, 0, 7])
    distance = np.hypot(ours[:, :2, 0], ours[:, :2, 1]), np.hypot(theirs[:, :2, 0], theirs[:, :2, 1])
    assert (np.diff(distance[0])[behind] < 0.0).all()
    assert (np.diff(distance[1])[behind] > 0.0).all()


def test_quantiles_and_counts_equal_numpys(groups, monkeypatch):
    monkeypatch.setattr(experiment, "SETTINGS", (RAW,))
    group = groups["a"]["law 13"]
    (one,) = summarise("a", 12, 1, [group])["groups"]
    outcomes, histories = group.outcomes, group.histories
    expected = {
        "position": np.hypot(outcomes[:, 0], outcomes[:, 1]),
        "abs_theta": np.abs(outcomes[:, 2]),
        "y": outcomes[:, 1],
        "path_length": outcomes[:, 4],
        "distance_at_10_s": np.hypot(histories[:, 100, 0], histories[:, 100, 1]),
    }
    for key, values in expected.items():
        assert one[key] == {name: pytest.approx(np.quantile(values, q)) for name, q in QUANTILES.items()}
    assert one["max_speed"] == np.abs(histories[:, :, 6]).max()
    assert one["settled"] == np.isfinite(outcomes[:, 3]).sum()
    assert one["reached_local_region"] == np.isfinite(outcomes[:, 7]).sum()
    for column, (key, value) in enumerate(zip(("x", "y", "theta"), PAPER_END_STATES["law 13"], strict=True)):
        found = one["paper"][key]
        assert found["share_below"] == (outcomes[:, column] < value).mean()
        assert found["magnitude_share_below"] == (np.abs(outcomes[:, column]) < abs(value)).mean()


def test_wrong_arguments_are_refused(tmp_path):
    with pytest.raises(InvalidValueError, match="runs = 0"):
        run_experiment("a", 0, 1)
    with pytest.raises(SystemExit) as caught:
        cli.main(["experiment", "scan", "--out", str(tmp_path / "out")])
    assert caught.value.code == 2
    assert not (tmp_path / "out").exists()


def test_the_command_writes_results_and_all_figures(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(paper_figures, "save", lambda figure, *paths: [plt.close(figure), *map(Path.touch, paths)])
    monkeypatch.setattr(experiment, "SETTINGS", (RAW, VANISHING))
    assert cli.main(["experiment", "a", "--runs", "3", "--out", str(tmp_path)]) == 0
    assert json.loads((tmp_path / "a" / "results.json").read_text())["runs"] == 3
    assert "experiment a" in capsys.readouterr().out
    kinds = ("path", "pose", "command") * 2
    stems = [f"figure_{number:02d}_{what}" for number, what in zip(range(4, 10), kinds, strict=True)]
    for setting in ("raw", "vanishing"):
        found = {path.name for path in (tmp_path / "a" / setting).iterdir()}
        assert found == {f"{stem}.png" for stem in stems}


def about(value):
    """Return a copy with tolerances for its floats."""
    if isinstance(value, dict):
        return {name: about(one) for name, one in value.items()}
    if isinstance(value, list):
        return [about(one) for one in value]
    return pytest.approx(value, rel=1e-6, abs=1e-9) if isinstance(value, float) else value


@pytest.mark.parametrize(("name", "setting"), [("a", EKF), ("b", VANISHING)])
def test_the_published_results_are_reproduced(name, setting, monkeypatch):
    """One setting of each experiment suffices, because all settings are computed by the same functions."""
    monkeypatch.setattr(experiment, "SETTINGS", (setting,))
    runs, seed = PUBLISHED[name]["runs"], PUBLISHED[name]["seed"]
    found = json.loads(json.dumps(summarise(name, runs, seed, run_experiment(name, runs, seed))))
    expected = PUBLISHED[name] | {
        "groups": [one for one in PUBLISHED[name]["groups"] if one["setting"] == setting.name],
        "literal_rear_sector": {
            key: one for key, one in PUBLISHED[name]["literal_rear_sector"].items() if key.startswith(setting.name)
        },
    }
    assert len(expected["groups"]) == len(expected["literal_rear_sector"]) == 2
    assert found == about(expected)
