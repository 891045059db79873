"""The picture of a demonstration shows the paths, the start and the goals of its record."""

import math

import figures
import matplotlib.image
import numpy as np
import pytest
from figures import drawn  # noqa: F401 - a fixture

from diffbot_core.geometry import Pose
from diffbot_lab.demo import figure as demo_figure
from diffbot_lab.demo.run_record import RunRecord


def path(*points):
    return np.array([(0.1 * index, *point, 0.0) for index, point in enumerate(points)])


TRUTH = path((1.0, 2.0), (2.0, 3.0), (6.0, 4.0))
TRUTH[0, 3] = 0.5 * math.pi
ESTIMATE = path((1.1, 2.2), (2.1, 3.3))
ODOMETRY = path((1.0, 2.0), (2.5, 2.5), (5.0, 7.0))
FIXES = path((0.7, 1.8), (6.3, 3.7))
GOALS = [(0.0, Pose(6.0, 4.5, 0.0)), (0.2, Pose(0.0, 0.0, math.pi))]
RECORD = RunRecord(TRUTH, ESTIMATE, ODOMETRY, FIXES, GOALS, 0, 0)
BLUE, ORANGE, GREY, GREEN, RED = "#0072B2", "#E69F00", "#999999", "#009E73", "#D55E00"


@pytest.fixture
def axes(drawn):  # noqa: F811
    saved = drawn(demo_figure)
    demo_figure.draw_run(RECORD, "a title", None)
    (figure,) = saved
    return figure.axes[0]


def test_each_path_is_drawn_under_its_own_name(axes):
    expected = {
        "truth": (TRUTH, BLUE),
        "estimate (EKF)": (ESTIMATE, RED),
        "odometry alone": (ODOMETRY, ORANGE),
        "fixes (global_pose)": (FIXES, GREY),
    }
    found = figures.lines(axes)
    assert found.keys() == expected.keys()
    for label, (points, colour) in expected.items():
        np.testing.assert_array_equal(found[label].get_xydata(), points[:, 1:3])
        assert figures.same_colour(found[label].get_color(), colour)
    assert found["fixes (global_pose)"].get_linestyle() == "None"
    assert {text.get_text() for text in axes.get_legend().get_texts()} == expected.keys()
    assert (axes.get_title(), axes.get_xlabel(), axes.get_ylabel()) == ("a title", "x [m]", "y [m]")


def test_start_and_goals_are_named_arrows_along_their_headings(axes):
    named = {text.get_text(): text for text in axes.texts if text.get_text()}
    assert {name: text.xy for name, text in named.items()} == {
        "start": (1.0, 2.0),
        "goal 1": (6.0, 4.5),
        "goal 2": (0.0, 0.0),
    }
    length = 0.07 * 5.0  # of the longer side of the truth
    arrows = [(*text.xyann, *text.xy) for text in axes.texts if not text.get_text()]
    expected = [(1.0, 2.0, 1.0, 2.0 + length), (6.0, 4.5, 6.0 + length, 4.5), (0.0, 0.0, -length, 0.0)]
    np.testing.assert_allclose(arrows, expected, atol=1e-12)
    colours = figures.colours_at(axes, [(1.0, 2.0), (6.0, 4.5), (0.0, 0.0)])
    for colour, name in zip(colours, (BLUE, GREEN, GREEN), strict=True):
        assert figures.same_colour(colour, name)


def test_the_file_is_a_png_of_its_size(tmp_path):
    demo_figure.draw_run(RECORD, "a title", tmp_path / "path.png")
    assert matplotlib.image.imread(tmp_path / "path.png").shape[:2] == (1000, 1200)
    assert [one.name for one in tmp_path.iterdir()] == ["path.png"]
