"""The paper's figures: each shows the runs of its own group, and the command writes all of them."""

import json
import math
import os
import subprocess
import sys
from concurrent.futures import Future
from xml.etree import ElementTree

import figures
import matplotlib.image
import numpy as np
import pytest
from figures import drawn  # noqa: F401 - a fixture
from matplotlib.collections import LineCollection

from diffbot_lab.paper import figures as paper_figures
from diffbot_lab.paper.experiment import table
from diffbot_lab.paper.figures import FIRST_FIGURE, figure_paths
from diffbot_lab.paper.scenarios import SETTINGS, Group
from diffbot_sim.compiled.batch import Starts

RAW = SETTINGS[0]
STEPS, RUNS = 20, 6
STARTS = np.array([(3.0, 4.0, 0.0), (-2.0, 1.0, 0.5 * math.pi)])
SVG = "{http://www.w3.org/2000/svg}"
COLOURS = ("#0072B2", "#D55E00")


class Inline:
    """Stands for a pool: the work is done at once."""

    def submit(self, function, *arguments):
        future = Future()
        future.set_result(function(*arguments))
        return future


@pytest.fixture
def histories():
    """Made-up histories (runs, steps + 1, 9), each number another one."""
    values = np.random.default_rng(1).normal(size=(RUNS, STEPS + 1, 9))
    for run in range(RUNS):
        values[run, 0, :3] = STARTS[run % 2]
    return values


@pytest.fixture
def shown(histories, drawn, tmp_path):  # noqa: F811
    """Path, pose and command of a group of two starts."""
    saved = drawn(paper_figures)
    group = Group("heading 0 deg", "law 17", RAW, Starts(STARTS), np.empty((RUNS, 9)), histories)
    paths = [future.result() for future in figure_paths([group], tmp_path, Inline())]
    stems = ("figure_10_path", "figure_11_pose", "figure_12_command")
    assert paths == [[tmp_path / "raw" / f"{stem}.{kind}" for kind in ("png", "svg")] for stem in stems]
    return saved


def faint(axes):
    """Return colour and paths of each bundle of faint lines."""
    bundles = [one for one in axes.collections if isinstance(one, LineCollection)]
    return [(one.get_color()[0], one.get_segments()) for one in bundles]


def test_the_paths_are_those_of_the_runs_by_start(shown, histories):
    (axes,) = shown[0].axes
    for start, (colour, paths) in enumerate(faint(axes)):
        np.testing.assert_array_equal(paths, histories[start::2, :, :2])
        assert figures.same_colour(colour[:3], COLOURS[start])
        np.testing.assert_array_equal(axes.lines[start].get_xydata(), histories[start, :, :2])
        assert figures.same_colour(axes.lines[start].get_color(), COLOURS[start])
    np.testing.assert_array_equal(figures.lines(axes)["goal (heading 0)"].get_xydata(), [(0.0, 0.0)])
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("x [m]", "y [m]")
    assert axes.get_title() == "Path: law 17, heading 0 deg, raw"


def test_an_arrow_at_each_start_has_its_heading(shown):
    arrows = [patch.get_xy() for patch in shown[0].axes[0].patches]
    for corners, (x, y, heading) in zip(arrows, STARTS, strict=True):
        along = (corners - (x, y)) @ (math.cos(heading), math.sin(heading))
        across = (corners - (x, y)) @ (-math.sin(heading), math.cos(heading))
        assert along.max() > 3.0 * np.abs(across).max()
        assert along.min() == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize(
    ("index", "columns", "labels", "title"),
    [(1, (0, 1, 2), ("x [m]", "y [m]", "theta [rad]"), "Pose"), (2, (6, 7), ("v [m/s]", "omega [rad/s]"), "Command")],
)
def test_a_series_has_each_quantity_over_time(shown, histories, index, columns, labels, title):
    panels = shown[index].axes
    assert [axes.get_ylabel() for axes in panels] == list(labels)
    assert panels[0].get_title() == f"{title}: law 17, heading 0 deg, raw"
    assert panels[-1].get_xlabel() == "time [s]"
    steps = STEPS + 1 if title == "Pose" else STEPS
    time = 0.1 * np.arange(steps)
    for axes, column, label in zip(panels, columns, labels, strict=True):
        values = histories[:, :steps, column]
        values = np.unwrap(values, axis=1) if label == "theta [rad]" else values
        bands = [one for one in axes.collections if not isinstance(one, LineCollection)]
        for start, (_, curves) in enumerate(faint(axes)):
            np.testing.assert_allclose([curve[:, 1] for curve in curves], values[start::2])
            np.testing.assert_allclose(curves[0][:, 0], time)
            np.testing.assert_allclose(axes.lines[start].get_xydata(), np.column_stack([time, values[start]]))
            (outline,) = bands[start].get_paths()
            low, high = np.quantile(values[start::2], (0.05, 0.95), axis=0)
            assert outline.vertices[:, 1].min() == pytest.approx(low.min())
            assert outline.vertices[:, 1].max() == pytest.approx(high.max())


def test_figures_are_numbered_as_the_papers():
    assert FIRST_FIGURE == {"law 13": 4, "law 17": 7, "heading 0 deg": 10, "heading 220 deg": 13}


def assert_files(stem):
    assert min(matplotlib.image.imread(stem.with_suffix(".png")).shape[:2]) > 300
    assert ElementTree.parse(stem.with_suffix(".svg")).getroot().tag == f"{SVG}svg"


def test_the_command_draws_all_figures_of_a(tmp_path):
    command = [sys.executable, "-m", "diffbot_lab.cli", "experiment", "a", "--runs", "3", "--out", str(tmp_path)]
    result = subprocess.run(command, capture_output=True, text=True, timeout=280, check=False, env=os.environ)
    assert result.returncode == 0, result.stderr
    content = json.loads((tmp_path / "a" / "results.json").read_text())
    assert content["runs"] == 3
    assert table(content) in result.stdout
    kinds = ("path", "pose", "command") * 2
    stems = [f"figure_{number:02d}_{what}" for number, what in zip(range(4, 10), kinds, strict=True)]
    for setting in ("raw", "ekf", "quiet"):
        found = {path.name for path in (tmp_path / "a" / setting).iterdir()}
        assert found == {f"{stem}.{kind}" for stem in stems for kind in ("png", "svg")}
        for stem in stems:
            assert_files(tmp_path / "a" / setting / stem)
