"""The picture of a demonstration shows the paths, the start and the goals of its record."""

import math

import figures
import numpy as np
from figures import drawn  # noqa: F401 - a fixture

from diffbot_core.geometry import Pose
from diffbot_tools.demo import figure as demo_figure
from diffbot_tools.demo.run_record import RunRecord


def path(*points):
    return np.array([(0.1 * index, *point, 0.5 * math.pi) for index, point in enumerate(points)])


TRUTH = path((1.0, 2.0), (2.0, 3.0), (6.0, 4.0))
PATHS = {
    "truth": (TRUTH, "#0072B2"),
    "estimate (EKF)": (path((1.1, 2.2), (2.1, 3.3)), "#D55E00"),
    "odometry alone": (path((1.0, 2.0), (2.5, 2.5), (5.0, 7.0)), "#E69F00"),
    "fixes (global_pose)": (path((0.7, 1.8), (6.3, 3.7)), "#999999"),
}
GOALS = [(0.0, Pose(6.0, 4.5, 0.0)), (0.2, Pose(0.0, 0.0, math.pi))]


def test_paths_start_and_goals_are_drawn_under_their_own_names(drawn):  # noqa: F811
    saved = drawn(demo_figure)
    demo_figure.draw_run(RunRecord(*(points for points, _ in PATHS.values()), GOALS, 0, 0), "a title", None)
    (axes,) = saved[0].axes
    found = figures.lines(axes)
    assert found.keys() == PATHS.keys()
    for label, (points, colour) in PATHS.items():
        np.testing.assert_array_equal(found[label].get_xydata(), points[:, 1:3])
        assert figures.same_colour(found[label].get_color(), colour)
    named = {text.get_text(): text.xy for text in axes.texts if text.get_text()}
    assert named == {"start": (1.0, 2.0), "goal 1": (6.0, 4.5), "goal 2": (0.0, 0.0)}
