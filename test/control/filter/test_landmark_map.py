"""The map of landmarks, and how a point is seen."""

import math

import numpy as np
import pytest
from filter_runs import (
    build_measurement,
    build_motion,
)

from diffbot_control.filter.gated_filter import GatedFilter
from diffbot_control.filter.landmark_map import LandmarkMap
from diffbot_control.filter.options import FilterConfig, options_of
from diffbot_core.errors import InvalidValueError
from diffbot_core.geometry import Pose
from diffbot_core.schema import build


def test_points_are_ordered_by_position_whatever_their_numbers():
    found = LandmarkMap((7, -2, 0), (3.0, 2.0, 2.0), (4.0, 6.0, 5.0)).points()
    assert list(found.items()) == [(0, (2.0, 5.0)), (-2, (2.0, 6.0)), (7, (3.0, 4.0))]


@pytest.mark.parametrize(
    ("ids", "x", "y", "name"),
    [
        ((1, 2, 1), (1.0, 2.0, 3.0), (1.0, 2.0, 3.0), "landmark_ids"),
        ((1, 2), (1.0,), (1.0, 2.0), "landmark_x"),
        ((1, 2), (1.0, 2.0), (1.0, 2.0, 3.0), "landmark_y"),
        ((), (1.0,), (1.0,), "landmark_x"),
    ],
)
def test_lists_that_do_not_belong_together_are_refused(ids, x, y, name):
    with pytest.raises(InvalidValueError, match=name):
        LandmarkMap(ids, x, y).check()
    with pytest.raises(InvalidValueError, match=name):
        build(LandmarkMap, {"landmark_ids": ids, "landmark_x": x, "landmark_y": y})


def nees_over_markers(variant, seen_within, runs=10):
    """Mean NEES of drives along a line of floor markers, seen only when they are near; fixes at 1 Hz."""
    options, found = options_of(FilterConfig(variant)), []
    for run in range(runs):
        rng = np.random.default_rng(run)
        made, truth = GatedFilter(options, 0.6), np.array([0.0, rng.uniform(-0.1, 0.1), 0.0])
        fix_R, R = np.diag([0.03, 0.03, 0.01]), np.diag([0.06**2, 0.03**2])
        made.reset_to(Pose(*(truth + rng.normal(size=3) * np.sqrt(fix_R.diagonal()))), fix_R)
        for step in range(1, 400):
            noise = rng.normal(size=2) * (0.02, 0.1)
            truth += [0.06 * math.cos(truth[2]), 0.06 * math.sin(truth[2]), 0.0]
            made.predict(build_motion(0.6 + noise[0], noise[1], 0.1, 4e-4, 0.0, 0.01))
            if step % 10 == 0:
                z = truth + rng.normal(size=3) * np.sqrt(fix_R.diagonal())
                made.take(build_measurement(0, z, fix_R))
            for x in np.arange(1.5, 30.0, 3.0):
                dx, dy = x - truth[0], -truth[1]
                if 0.01 < math.hypot(dx, dy) <= seen_within:
                    z = np.array([math.hypot(dx, dy), math.atan2(dy, dx) - truth[2]])
                    z += rng.normal(size=2) * (0.06, 0.03)
                    if z[0] > 0.0:
                        z[1] = math.remainder(z[1], 2.0 * math.pi)
                        made.take(build_measurement(0, z, R, (x, 0.0)))
            if step > 50:
                x, P = made.memory.belief
                error = x[:3] - truth
                error[2] = math.remainder(error[2], 2.0 * math.pi)
                found.append(error @ np.linalg.solve(P[:3, :3], error))
    return np.mean(found)


@pytest.mark.parametrize("seen_within", [0.3, 3.0])
def test_markers_underfoot_do_not_make_the_filter_overconfident(seen_within):
    # Of three numbers; without the second-order terms it is about 90 here.
    assert nees_over_markers("ekf", seen_within) < 4.0
