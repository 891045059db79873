"""The paper's figures: each shows the runs of its own group, and the command writes all of them."""

import contextlib
import json
import math
from concurrent.futures import Future
from pathlib import Path

import figures
import matplotlib.pyplot as plt
import numpy as np
import pytest
from figures import drawn  # noqa: F401 - a fixture
from matplotlib.collections import LineCollection

from diffbot_lab.paper import experiment
from diffbot_lab.paper import figures as paper_figures
from diffbot_lab.paper.figures import figure_paths
from diffbot_lab.paper.scenarios import SETTINGS, Group
from diffbot_sim.compiled.batch import Starts
from diffbot_tools import cli

RAW = SETTINGS[0]
STEPS, RUNS = 20, 6
STARTS = np.array([(3.0, 4.0, 0.0), (-2.0, 1.0, 0.5 * math.pi)])
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


def test_a_series_has_each_quantity_over_time(shown, histories):
    labels = ("x [m]", "y [m]", "theta [rad]", "v [m/s]", "omega [rad/s]")
    panels = [*shown[1].axes, *shown[2].axes]
    assert [axes.get_ylabel() for axes in panels] == list(labels)
    for axes, column in zip(panels, (0, 1, 2, 6, 7), strict=True):
        values = histories[:, : STEPS + (column < 3), column]
        values = np.unwrap(values, axis=1) if column == 2 else values
        for start, (_, curves) in enumerate(faint(axes)):
            np.testing.assert_allclose([curve[:, 1] for curve in curves], values[start::2])
            np.testing.assert_allclose(curves[0][:, 0], 0.1 * np.arange(values.shape[1]))


def test_the_command_draws_all_figures_of_a(tmp_path, monkeypatch):
    monkeypatch.setattr(experiment, "ProcessPoolExecutor", lambda *_, **__: contextlib.nullcontext(Inline()))
    monkeypatch.setattr(paper_figures, "save", lambda figure, *paths: [plt.close(figure), *map(Path.touch, paths)])
    assert cli.main(["experiment", "a", "--runs", "3", "--out", str(tmp_path)]) == 0
    assert json.loads((tmp_path / "a" / "results.json").read_text())["runs"] == 3
    kinds = ("path", "pose", "command") * 2
    stems = [f"figure_{number:02d}_{what}" for number, what in zip(range(4, 10), kinds, strict=True)]
    for setting in ("raw", "ekf", "quiet"):
        found = {path.name for path in (tmp_path / "a" / setting).iterdir()}
        assert found == {f"{stem}.{kind}" for stem in stems for kind in ("png", "svg")}
