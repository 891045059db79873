"""The state file: it restores the saved state, and a broken file is reported and kept."""

import json
import math
import threading

import numpy as np
import pytest

from diffbot_control.filter import state, state_file
from diffbot_control.filter.config import FilterConfig, LocalizationConfig
from diffbot_control.filter.localization import Localization
from diffbot_control.filter.odometry import OdometryStep
from diffbot_control.filter.state_file import (
    BrokenStateError,
    SavedState,
    StateKeeper,
    load_state,
    save_state,
)
from diffbot_core.geometry import Point, Pose
from diffbot_core.kinematics import Twist, TwistCovariance, WheelGeometry

P = np.array([[0.02, 0.001, 0.0], [0.001, 0.03, -0.002], [0.0, -0.002, 0.01]])
ERRORS = np.array([0.01, -0.02, 0.05]), np.array([[1e-5, 2e-6, 0.0], [2e-6, 3e-5, 0.0], [0.0, 0.0, 1e-4]])
GEOMETRY = WheelGeometry(0.07, 0.5)


def saved(path, errors=ERRORS):
    by_name = {} if errors is None else {"wheels": errors, "landmarks": errors}
    save_state(path, SavedState(Pose(1.0, -2.0, 3.0), P, GEOMETRY, by_name))


def assert_errors(found, expected=ERRORS):
    for one, other in zip(found, expected, strict=True):
        np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize("errors", [ERRORS, None])
def test_a_saved_state_is_loaded_unchanged(tmp_path, errors):
    path = tmp_path / "new" / "state.json"
    saved(path, errors)
    found = load_state(path)
    assert (found.pose, found.geometry) == ((1.0, -2.0, 3.0), GEOMETRY)
    np.testing.assert_array_equal(found.P, P)
    assert list(found.errors) == ([] if errors is None else ["wheels", "landmarks"])
    for one in found.errors.values():
        assert_errors(one)
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
        {"geometry": ["wide", 0.5]},
        "null",
        "[" * 5000,
        "1" * 100_000,
    ],
)
def test_a_broken_file_is_reported_renamed_and_not_used(tmp_path, change):
    path, found = tmp_path / "state.json", Localization(LocalizationConfig())
    assert load_state(path) is None
    assert StateKeeper(path, found).restore(GEOMETRY) == "no state to restore"
    saved(path)
    text = json.dumps({**json.loads(path.read_text()), **change}) if isinstance(change, dict) else change
    path.write_text(text)
    with pytest.raises(BrokenStateError) as caught:
        StateKeeper(path, found).restore(GEOMETRY)
    assert str(caught.value).startswith(str(path))
    assert "\n" not in str(caught.value)
    assert [one.name for one in tmp_path.iterdir()] == ["state.json.bad"]
    assert (tmp_path / "state.json.bad").read_text() == text
    assert not found.initialised


def test_restore_and_save_contain_the_errors_that_the_filter_estimates(tmp_path):
    path, places = tmp_path / "state.json", (Point(3.0, 4.0),)
    saved(path)
    whole = Localization(LocalizationConfig(), landmarks=places)
    two = Localization(LocalizationConfig(filter=FilterConfig(wheel_separation_sigma=0.0)))
    keeper = StateKeeper(path, whole)
    for one in (keeper, StateKeeper(path, two)):
        assert one.restore(GEOMETRY) == "state restored: x 1.000 m, y -2.000 m, heading 3.000 rad"
    for first in (3, 7):
        assert_errors((whole.filter.x[first : first + 3], whole.filter.P[first : first + 3, first : first + 3]))
    assert two.filter.x[3:].tolist() == [0.01, -0.02, 0.0]
    np.testing.assert_array_equal(two.filter.P[3:5, 3:5], ERRORS[1][:2, :2])
    now = 2.0 * ERRORS[0], ERRORS[1]
    for one in (whole, two):
        one.on_odometry(OdometryStep(10**9, Twist(0.0, 0.0), TwistCovariance(1e-4, 0.0, 1e-4)))
    state.set_errors(whole.filter, whole.options, 3, *now)
    keeper.save(GEOMETRY)
    assert_errors(load_state(path).errors["wheels"], now)
    assert_errors(load_state(path).errors["landmarks"])
    # The other filter does not estimate the separation error, and saves it with the variance 0.
    StateKeeper(path, two).save(GEOMETRY)
    assert_errors(load_state(path).errors["wheels"], (two.filter.x[3:6], two.filter.P[3:6, 3:6]))
    assert two.filter.P[5, 5] == 0.0
    keeper.delete()
    keeper.delete()
    assert not path.exists()


def test_wheel_errors_are_not_restored_for_another_geometry(tmp_path):
    saved(tmp_path / "state.json")
    found = Localization(LocalizationConfig())
    done = StateKeeper(tmp_path / "state.json", found).restore(WheelGeometry(0.05, 0.5))
    assert "wheel errors not restored" in done
    assert found.initialised
    assert found.filter.x.tolist() == [1.0, -2.0, 3.0, 0.0, 0.0, 0.0]


def test_a_state_is_not_saved_before_the_first_fix_twice_or_if_it_is_not_finite(tmp_path):
    path, found = tmp_path / "state.json", Localization(LocalizationConfig())
    keeper = StateKeeper(path, found)
    keeper.save(GEOMETRY)
    assert not path.exists()
    found.initialise(Pose(0.0, 0.0, 0.0), P, 0)
    keeper.save(GEOMETRY)
    path.unlink()
    keeper.save(GEOMETRY)
    assert not path.exists(), "the same stamp"
    found.on_odometry(OdometryStep(10**9, Twist(0.0, 0.0), TwistCovariance(1e-4, 0.0, 1e-4)))
    found.filter.P[0, 0] = math.nan
    keeper.save(GEOMETRY)
    assert not path.exists()


def test_a_busy_disk_does_not_delay_the_filter_and_the_last_state_is_saved(tmp_path, monkeypatch):
    path, found, is_free = tmp_path / "state.json", Localization(LocalizationConfig()), threading.Event()
    monkeypatch.setattr(state_file, "save_state", lambda *given: is_free.wait(20.0) and save_state(*given))
    keeper = StateKeeper(path, found)
    for second in range(3):
        found.initialise(Pose(float(second), 0.0, 0.0), P, second * 10**9)
        found.on_odometry(OdometryStep((second + 1) * 10**9, Twist(0.0, 0.0), TwistCovariance(1e-4, 0.0, 1e-4)))
        keeper.start_save(GEOMETRY)
    assert not path.exists()
    is_free.set()
    keeper.save(GEOMETRY)
    assert load_state(path).pose == (2.0, 0.0, 0.0)


def test_an_error_of_the_disk_is_raised_by_the_next_save(tmp_path):
    path, found = tmp_path / "file" / "state.json", Localization(LocalizationConfig())
    (tmp_path / "file").write_text("")
    keeper = StateKeeper(path, found)
    found.initialise(Pose(0.0, 0.0, 0.0), P, 0)
    keeper.start_save(GEOMETRY)
    with pytest.raises(OSError, match="file"):
        keeper.save(GEOMETRY)
