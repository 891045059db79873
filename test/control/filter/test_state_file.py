"""The state file: what is written is read, what is broken is said, and nothing else is touched."""

import json
import math

import numpy as np
import pytest
from filter_runs import odometry_step

from diffbot_control.filter.belief import ErrorEstimate
from diffbot_control.filter.localization import Localization
from diffbot_control.filter.localization_config import LocalizationConfig
from diffbot_control.filter.options import FilterConfig
from diffbot_control.filter.state_file import BrokenStateError, SavedState, StateKeeper, load_state, save_state
from diffbot_core.geometry import Pose
from diffbot_core.kinematics import Twist, WheelGeometry

P = np.array([[0.02, 0.001, 0.0], [0.001, 0.03, -0.002], [0.0, -0.002, 0.01]])
WHEELS = np.array([0.01, -0.02, 0.05])
WHEELS_P = np.array([[1e-5, 2e-6, 0.0], [2e-6, 3e-5, 0.0], [0.0, 0.0, 1e-4]])
GEOMETRY = WheelGeometry(0.07, 0.5)
GOOD = {
    "version": 1,
    "pose": [1.0, -2.0, 3.0],
    "P": P.tolist(),
    "geometry": [0.07, 0.5],
    "wheels": WHEELS.tolist(),
    "wheels_P": WHEELS_P.tolist(),
}


@pytest.mark.parametrize("wheels", [ErrorEstimate(WHEELS, WHEELS_P), None])
def test_what_is_written_is_read_to_the_bit(tmp_path, wheels):
    path = tmp_path / "new" / "state.json"
    save_state(path, SavedState(Pose(1.0, -2.0, 3.0), P, wheels, GEOMETRY, wheels))
    found = load_state(path)
    assert (found.pose, found.geometry) == ((1.0, -2.0, 3.0), GEOMETRY)
    np.testing.assert_array_equal(found.P, P)
    if wheels is None:
        assert found.wheels is found.landmarks is None
    else:
        for one in (found.wheels, found.landmarks):
            np.testing.assert_array_equal(one.errors, WHEELS)
            np.testing.assert_array_equal(one.P, WHEELS_P)
    assert [one.name for one in path.parent.iterdir()] == ["state.json"]


@pytest.mark.parametrize(
    "change",
    [
        {"version": 2},
        {"pose": [1.0, math.nan, 0.0]},
        {"pose": [1e8, 0.0, 0.0]},
        {"P": (-P).tolist()},
        {"P": [[1e300] * 3] * 3},
        {"wheels": [2.0, 0.0, 0.0]},
        {"wheels_P": [[0.0, 0.0], [0.0, 0.0]]},
        "null",
        "[" * 5000,
    ],
)
def test_a_file_with_something_else_is_one_line(tmp_path, change):
    path = tmp_path / "state.json"
    assert load_state(path) is None
    path.write_text(json.dumps({**GOOD, **change}) if isinstance(change, dict) else change)
    with pytest.raises(BrokenStateError) as caught:
        load_state(path)
    assert str(caught.value).startswith(str(path))
    assert "\n" not in str(caught.value)


def test_radii_are_restored_to_any_filter_that_has_them_and_other_errors_where_they_are_states(tmp_path):
    states = FilterConfig(wheel_separation_sigma=0.1, landmark_range_offset_sigma=0.1)
    three = Localization(LocalizationConfig(filter=states), landmarks=True)
    two = Localization(LocalizationConfig(filter=FilterConfig(wheel_separation_sigma=0.0)))
    path = tmp_path / "state.json"
    errors = ErrorEstimate(WHEELS, WHEELS_P)
    save_state(path, SavedState(Pose(1.0, -2.0, 3.0), P, errors, GEOMETRY, errors))
    for localization in (three, two):
        assert StateKeeper(path, localization).restore(GEOMETRY) == (
            "state restored: x 1.000 m, y -2.000 m, heading 3.000 rad"
        )
    np.testing.assert_array_equal(three.filter.wheels().errors, WHEELS)
    np.testing.assert_array_equal(three.filter.landmark_errors().errors, WHEELS)
    assert two.filter.landmark_errors() is None
    np.testing.assert_array_equal(two.filter.wheels().errors, WHEELS[:2])
    np.testing.assert_array_equal(two.filter.wheels().P, WHEELS_P[:2, :2])
    three.on_odometry(odometry_step(10**9, Twist(0.0, 0.0), 1e-4, 0.0, 1e-4))
    three.filter.set_wheels(ErrorEstimate(2.0 * WHEELS, WHEELS_P))
    StateKeeper(path, three).save(GEOMETRY)
    np.testing.assert_array_equal(load_state(path).wheels.errors, 2.0 * WHEELS, "those of now")
    np.testing.assert_array_equal(load_state(path).landmarks.errors, WHEELS)
    other = Localization(three.config)
    assert "wheel errors not restored" in StateKeeper(path, other).restore(WheelGeometry(0.05, 0.5))
    assert not other.filter.wheels().errors.any()
