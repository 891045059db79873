"""The paper's experiments: what they show, the page made from them, and their figures."""

import copy
import json
import math
import os
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from xml.etree import ElementTree

import matplotlib.image
import numpy as np
import pytest
from reproduction import page, statements

from diffbot_core.errors import DiffbotError, InvalidValueError
from diffbot_lab import cli
from diffbot_lab.paper.experiment import (
    GOAL,
    HEADINGS_B,
    LAWS,
    PAPER_END_STATES,
    QUANTILES,
    SETTINGS,
    STEPS,
    case_of,
    run_experiment,
    starts_of,
    summarise,
    table,
)
from diffbot_lab.paper.figures import FIRST_FIGURE, figure_paths
from diffbot_sim.compiled.batch import HISTORY_COLUMNS, run_histories

ROOT = Path(__file__).resolve().parents[3]
DOCS = ROOT / "docs"
RAW, EKF, QUIET = SETTINGS
SVG = "{http://www.w3.org/2000/svg}"


def wrapped(angles):
    return math.pi - np.remainder(math.pi - np.asarray(angles), 2.0 * math.pi)


@pytest.fixture(scope="module")
def groups():
    return {name: run_experiment(name, 12, 1) for name in ("a", "b")}


@pytest.fixture(scope="module")
def results(groups):
    return {name: summarise(name, 12, 1, groups[name]) for name in groups}


@pytest.fixture(scope="module")
def kept():
    return json.loads((DOCS / "reproduction.json").read_text())


def of(groups, label, setting):
    (found,) = [one for one in groups if one.label == label and one.setting.name == setting]
    return found


def test_the_settings_are_the_papers(groups):
    assert STEPS * RAW.plant.sampling_time == pytest.approx(30.0)
    assert GOAL == (0.0, 0.0, 0.0)
    a = of(groups["a"], "law 17", "raw").histories
    assert (a[:, 0, :3] == [-2.0, -5.5, math.pi / 6.0]).all()
    errors = a[:, :, 3:6] - a[:, :, :3]
    for error, bound in zip((errors[..., 0], errors[..., 1], wrapped(errors[..., 2])), (0.3, 0.3, 0.17), strict=True):
        assert 0.99 * bound < np.abs(error).max() <= bound
        assert error.std() == pytest.approx(bound / math.sqrt(3.0), rel=0.03)
    # Euler's step (3) from row to row; what is left over is the input noise.
    moved = np.diff(a[:, :, :2], axis=1)
    theta = a[:, :-1, 2]
    v = (moved[..., 0] * np.cos(theta) + moved[..., 1] * np.sin(theta)) / 0.1
    omega = wrapped(np.diff(a[:, :, 2], axis=1)) / 0.1
    assert np.abs(moved[..., 1] * np.cos(theta) - moved[..., 0] * np.sin(theta)).max() < 1e-12
    for noise, bound in ((v - a[:, :-1, 6], 0.065), (omega - a[:, :-1, 7], 0.2167)):
        assert 0.99 * bound < np.abs(noise).max() <= bound + 1e-9
        assert noise.std() == pytest.approx(bound / math.sqrt(3.0), rel=0.03)


def test_the_starts_of_b_are_on_the_circle(groups):
    for heading, label in zip(HEADINGS_B, ("heading 0 deg", "heading 220 deg"), strict=True):
        first = of(groups["b"], label, "quiet").histories[:8, 0, :3]
        angles = np.radians(45.0 * np.arange(8))
        assert first[:, :2] == pytest.approx(12.0 * np.column_stack([np.cos(angles), np.sin(angles)]), abs=1e-12)
        assert wrapped(first[:, 2] - math.radians(heading)) == pytest.approx(np.zeros(8), abs=1e-12)
        assert (np.abs(first[:, 2]) <= math.pi).all()


def law(x, y, theta, near):
    """Textbook law (17): gamma 1.3, k 1, h 0.17, k2 2.7, velocity along the real axis."""
    rho, beta = np.hypot(x, y), np.arctan2(0.0 - y, 0.0 - x)
    alpha = wrapped(beta - theta)
    v = 1.3 * np.tanh(rho) * np.cos(alpha)
    far = alpha + 1.3 * np.sinc(alpha / math.pi) * np.tanh(rho) / rho * np.cos(alpha) * (alpha + 0.17 * beta)
    return v, np.where(near, -2.7 * theta, far)


@pytest.mark.parametrize("name", LAWS)
@pytest.mark.parametrize("setting", [RAW, QUIET], ids=["raw", "quiet"])
def test_the_commands_are_the_papers_law(name, setting):
    history = run_histories(case_of(name, setting), starts_of("b", 220.0), 2, 0, 16)[:, :100]
    seen = history[..., 3:6] if setting is RAW else history[..., :3]
    x, y, theta = np.moveaxis(seen, -1, 0)
    near = np.hypot(x, y) < 0.5 if name == "law 17" else np.zeros(x.shape, bool)
    v, omega = law(x, y, theta, near)
    assert near.any() == (name == "law 17")
    assert history[..., 6] == pytest.approx(v, abs=1e-12)
    assert history[..., 7] == pytest.approx(omega, abs=1e-12)


def test_as_printed_the_rear_sector_drives_away():
    case, printed = case_of("law 17", QUIET), case_of("law 17", QUIET, literal_rear=True)
    ours, theirs = (run_histories(one, starts_of("b", 0.0), 1, 0, 8) for one in (case, printed))
    x = starts_of("b", 0.0).poses[:, 0]
    front, behind = x < -1e-9, x > 1e-9
    assert (front.sum(), behind.sum()) == (3, 3)
    np.testing.assert_array_equal(ours[front, 0, 6], theirs[front, 0, 6])
    np.testing.assert_array_equal(ours[behind, 0, 6], -theirs[behind, 0, 6])
    np.testing.assert_array_equal(ours[:, 0, 7], theirs[:, 0, 7])
    distance = np.hypot(ours[:, :2, 0], ours[:, :2, 1]), np.hypot(theirs[:, :2, 0], theirs[:, :2, 1])
    assert (np.diff(distance[0])[behind] < 0.0).all()
    assert (np.diff(distance[1])[behind] > 0.0).all()


def test_what_the_page_says_holds_in_shape(groups):
    ends = {(one.label, one.setting.name): one.outcomes for name in groups for one in groups[name]}
    position = {key: np.hypot(table[:, 0], table[:, 1]) for key, table in ends.items()}
    theta = {key: np.abs(table[:, 2]) for key, table in ends.items()}
    # Law (13): the position, but any heading.
    assert np.quantile(position["law 13", "raw"], 0.95) < 0.2
    assert theta["law 13", "raw"].max() > 2.0
    assert np.median(theta["law 13", "raw"]) > 1.0
    # Law (17): the heading, but a lateral error, with and without noise; along the goal's axis there is none.
    for label in ("law 17", "heading 0 deg", "heading 220 deg"):
        for setting in ("raw", "ekf", "quiet"):
            assert np.median(theta[label, setting]) < 0.1
            assert 0.1 < np.median(position[label, setting]) < 0.5
            assert np.median(np.abs(ends[label, setting][:, 0])) < 0.1
    for heading in ("heading 0 deg", "heading 220 deg"):
        for setting in ("raw", "ekf", "quiet"):
            local_time = ends[heading, setting][:, 7]
            assert np.isfinite(local_time).all()
            assert np.isfinite(local_time.reshape(-1, 8)).all(axis=0).sum() == 8
    for name in groups:
        for one in groups[name]:
            assert np.abs(one.histories[..., 6]).max() <= 1.3
            assert np.isfinite(one.histories[..., 6:]).all()
            assert (one.outcomes[:, :3] == one.histories[:, -1, :3]).all()


def test_the_results_are_numpys(groups, results):
    for name in ("a", "b"):
        content = results[name]
        assert (content["experiment"], content["runs"], content["seed"], content["steps"]) == (name, 12, 1, 300)
        assert len(content["groups"]) == len(groups[name]) == 6
        for one, group in zip(content["groups"], groups[name], strict=True):
            outcomes, histories = group.outcomes, group.histories
            assert one["runs"] == len(outcomes) == (12 if name == "a" else 96)
            expected = {
                "position": np.hypot(outcomes[:, 0], outcomes[:, 1]),
                "abs_theta": np.abs(outcomes[:, 2]),
                "y": outcomes[:, 1],
                "path_length": outcomes[:, 4],
                "distance_at_10_s": np.hypot(histories[:, 100, 0], histories[:, 100, 1]),
            }
            for key, values in expected.items():
                assert one[key] == {f"{q:g}": pytest.approx(np.quantile(values, q)) for q in QUANTILES}
            assert one["max_speed"] == np.abs(histories[:, :, 6]).max()
            assert one["settled"] == np.isfinite(outcomes[:, 3]).sum()
            assert one["reached_local_region"] == np.isfinite(outcomes[:, 7]).sum()
            assert ("paper" in one) == (name == "a" and one["setting"] != "quiet")
            if "paper" in one:
                for column, key in enumerate(("x", "y", "theta")):
                    value = PAPER_END_STATES[one["law"]][column]
                    assert one["paper"][key]["value"] == value
                    assert one["paper"][key]["share_below"] == (outcomes[:, column] < value).mean()
                    smaller = (np.abs(outcomes[:, column]) < abs(value)).mean()
                    assert one["paper"][key]["magnitude_share_below"] == smaller
    lines = table(results["a"]).splitlines()
    assert len(lines) == 8
    assert "0.0000" not in lines[2]


def assert_close(found, wanted, where=""):
    if isinstance(wanted, dict):
        assert found.keys() == wanted.keys(), where
        for key in wanted:
            assert_close(found[key], wanted[key], f"{where}.{key}")
    elif isinstance(wanted, list):
        assert len(found) == len(wanted), where
        for number, (one, other) in enumerate(zip(found, wanted, strict=True)):
            assert_close(one, other, f"{where}[{number}]")
    else:
        expected = pytest.approx(wanted, rel=1e-6, abs=1e-9) if isinstance(wanted, float) else wanted
        assert found == expected, where


@pytest.mark.parametrize("name", ["a", "b"])
def test_the_kept_results_are_todays(name, kept):
    runs, seed = kept[name]["runs"], kept[name]["seed"]
    found = summarise(name, runs, seed, run_experiment(name, runs, seed))
    assert_close(json.loads(json.dumps(found)), kept[name])


def test_the_page_is_made_from_the_kept_results(kept):
    assert (DOCS / "reproduction.md").read_text() == page(kept["a"], kept["b"])


def test_all_statements_hold_in_the_kept_results(kept):
    assert [one.text for one in statements(kept["a"], kept["b"]) if not one.holds] == []
    assert "NO |" not in page(kept["a"], kept["b"])


def change(results, law=None, setting=None, **changes):
    for one in results["groups"]:
        if law in (None, one["law"]) and setting in (None, one["setting"]):
            for key, value in changes.items():
                if isinstance(value, dict):
                    one[key] = {**one[key], **value}
                else:
                    one[key] = value


MUTATIONS = {
    "|v| never": lambda a, b: change(b, "law 17", "quiet", max_speed=1.3001),
    "Law (13) brings": lambda a, b: change(a, "law 13", "raw", abs_theta={"0.95": 1.9}),
    "Law (13) brings the position": lambda a, b: change(a, "law 13", "raw", position={"0.95": 0.21}),
    "Law (17) brings |theta|": lambda a, b: change(b, "law 17", "ekf", abs_theta={"0.5": 0.11}),
    "Law (17) leaves": lambda a, b: change(a, "law 17", "quiet", position={"0.5": 0.09}),
    "Law (17) leaves a lateral": lambda a, b: change(a, "law 17", "raw", position={"0.5": 0.09}),
    "B: all 16 starts": lambda a, b: change(b, None, "raw", reached_local_region=799),
    "With the rear sector": lambda a, b: b["literal_rear_sector"]["raw as printed"]["position"].update({"0.5": 0.3}),
}


@pytest.mark.parametrize("start", MUTATIONS)
def test_the_page_says_no_to_what_does_not_hold(start, kept):
    a, b = copy.deepcopy(kept["a"]), copy.deepcopy(kept["b"])
    MUTATIONS[start](a, b)
    failing = [one.text for one in statements(a, b) if not one.holds]
    assert len(failing) == 1
    assert failing[0].startswith(start)
    lines = [line for line in page(a, b).splitlines() if line.endswith("| NO |")]
    assert len(lines) == 1
    assert lines[0].startswith("| " + start.replace("|", "\\|"))


def assert_a_figure(stem):
    pixels = matplotlib.image.imread(stem.with_suffix(".png"))[:, :, :3]
    assert min(pixels.shape[:2]) > 300
    assert len(np.unique((pixels.reshape(-1, 3) * 255).astype(int), axis=0)) > 50
    assert 0.01 < (pixels < 0.9).any(axis=2).mean() < 0.9
    root = ElementTree.parse(stem.with_suffix(".svg")).getroot()
    assert root.tag == f"{SVG}svg"
    assert len(list(root.iter(f"{SVG}path"))) > 20


def test_each_group_has_its_figures(groups, tmp_path):
    shown = [one._replace(histories=one.histories[:16]) for one in groups["b"] if one.setting.name == "raw"]
    shown[1] = shown[1]._replace(setting=QUIET)
    with ThreadPoolExecutor(1) as pool:
        for future in list(figure_paths(shown, tmp_path, pool)):
            future.result()
    names = {
        "raw": ("figure_10_path", "figure_11_pose", "figure_12_command"),
        "quiet": ("figure_13_path", "figure_14_pose", "figure_15_command"),
    }
    for setting, stems in names.items():
        assert {path.name for path in (tmp_path / setting).iterdir()} == {
            f"{stem}.{kind}" for stem in stems for kind in ("png", "svg")
        }
        for stem in stems:
            assert_a_figure(tmp_path / setting / stem)


def test_figures_are_numbered_as_the_papers():
    assert FIRST_FIGURE == {"law 13": 4, "law 17": 7, "heading 0 deg": 10, "heading 220 deg": 13}


@pytest.mark.graph
def test_the_command_draws_all_figures_of_a(tmp_path):
    command = [sys.executable, "-m", "diffbot_lab.cli", "experiment", "a", "--runs", "3", "--out", str(tmp_path)]
    result = subprocess.run(command, capture_output=True, text=True, timeout=110, check=False, env=os.environ)
    assert result.returncode == 0, result.stderr
    content = json.loads((tmp_path / "a" / "results.json").read_text())
    assert content["runs"] == 3
    assert table(content) in result.stdout
    stems = [
        f"figure_{number:02d}_{what}"
        for number, what in zip(range(4, 10), ("path", "pose", "command") * 2, strict=True)
    ]
    for setting in ("raw", "ekf", "quiet"):
        found = {path.name for path in (tmp_path / "a" / setting).iterdir()}
        assert found == {f"{stem}.{kind}" for stem in stems for kind in ("png", "svg")}
        for stem in stems:
            assert_a_figure(tmp_path / "a" / setting / stem)


def test_without_figures_there_are_only_results(tmp_path, capsys):
    arguments = [
        "experiment",
        "a",
        "b",
        "a",
        "--runs",
        "2",
        "--seed",
        "5",
        "--no-figures",
        "--out",
        str(tmp_path / "new" / "x"),
    ]
    assert cli.main(arguments) == 0
    assert sorted(str(path.relative_to(tmp_path)) for path in tmp_path.rglob("*.*")) == [
        "new/x/a/results.json",
        "new/x/b/results.json",
    ]
    assert capsys.readouterr().out.count("experiment a") == 1
    assert json.loads((tmp_path / "new/x/b/results.json").read_text())["seed"] == 5


@pytest.mark.parametrize("blocked", ["out", "out/a", "out/a/results.json"])
def test_what_cannot_be_written_is_one_line(blocked, tmp_path, capsys):
    path = tmp_path / blocked
    path.parent.mkdir(parents=True, exist_ok=True)
    if blocked.endswith("json"):
        path.mkdir()
    else:
        path.write_text("mine")
    assert cli.main(["experiment", "a", "--runs", "1", "--no-figures", "--out", str(tmp_path / "out")]) == 1
    error = capsys.readouterr().err
    assert error.startswith("diffbot: cannot write ")
    assert error.count("\n") == 1


def test_a_figure_that_cannot_be_written_is_one_line(tmp_path, capsys):
    (tmp_path / "a").mkdir()
    (tmp_path / "a" / "ekf").write_text("mine")
    assert cli.main(["experiment", "a", "--runs", "1", "--out", str(tmp_path)]) == 1
    error = capsys.readouterr().err
    assert error.startswith("diffbot: cannot write ")
    assert "Traceback" not in error


@pytest.mark.parametrize(
    "arguments",
    [["c"], [], ["a", "--runs", "0"], ["a", "--runs", "x"], ["a", "--seed", "-1"], ["a", "--seed", str(2**63)]],
)
def test_wrong_usage(arguments, tmp_path, capsys):
    with pytest.raises(SystemExit) as caught:
        cli.main(["experiment", *arguments, "--out", str(tmp_path / "out")])
    assert caught.value.code == 2
    assert "Traceback" not in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(("name", "runs", "message"), [("c", 1, "experiment = 'c'"), ("a", 0, "runs = 0")])
def test_wrong_arguments_are_named(name, runs, message):
    with pytest.raises(InvalidValueError, match=message) as caught:
        run_experiment(name, runs, 1)
    assert isinstance(caught.value, DiffbotError)


def test_columns_of_histories():
    assert HISTORY_COLUMNS == ("x", "y", "theta", "seen_x", "seen_y", "seen_theta", "v", "omega")
