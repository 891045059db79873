"""Start of the filter with old, late and future fixes, and clocks that are set while the robot drives."""

import math

import numpy as np
import pytest
import stamped
from filter_runs import SEPARATION
from stamped import PERIOD

from diffbot_control.filter.config import FilterConfig, LocalizationConfig
from diffbot_control.filter.localization import Localization
from diffbot_control.filter.measurement import pose_fix
from diffbot_control.filter.odometry import OdometryStep
from diffbot_core.errors import BadMessageError
from diffbot_core.geometry import Pose
from diffbot_core.kinematics import Twist, TwistCovariance

BEGIN = 10**18
SURE = np.diag((4e-4, 4e-4, 4e-4))


def unstarted():
    return Localization(LocalizationConfig(filter=FilterConfig(filter="ekf")), SEPARATION, 1.0)


def odometry(number, v=0.4, omega=0.0, step=0.0):
    stamp = BEGIN + number * PERIOD + round(step * 1e9)
    return OdometryStep(stamp, Twist(v, omega), TwistCovariance(1e-4, 0.0, 1e-4))


def drive(found, numbers, **values):
    """Add odometry with these numbers; return the kinds of the errors."""
    refused = []
    for number in numbers:
        try:
            found.on_odometry(odometry(number, **values))
        except BadMessageError as error:
            refused.append(error.kind)
    return refused


def fix(time, x=0.0):
    return pose_fix(BEGIN + round(time * 1e9), Pose(x, 0.0, 0.0), SURE)


@pytest.mark.parametrize("age", [1.0, 100_000.0])
def test_a_fix_of_any_age_starts_the_filter_if_the_robot_is_at_rest(age):
    for is_first in (True, False):
        found = unstarted()
        if not is_first:
            drive(found, range(30), v=0.0)
        found.on_measurement(fix(3.0 - age, 2.0))
        drive(found, range(31, 35), v=0.0)
        estimate = found.estimate()
        assert estimate.pose == pytest.approx((2.0, 0.0, 0.0), abs=1e-9)
        assert math.sqrt(estimate.P[0, 0]) < 0.03


def test_a_late_first_fix_is_moved_by_the_odometry_since_its_stamp():
    found = unstarted()
    assert drive(found, range(30)) == ["no fix yet"] * 30
    found.on_measurement(fix(2.45))
    assert drive(found, [30]) == []
    assert found.estimate().stamp == BEGIN + 30 * PERIOD
    assert found.estimate().pose.x == pytest.approx(0.4 * 0.55)


@pytest.mark.parametrize("age", [3.0, 100.0])
def test_the_deviation_of_a_fix_before_the_history_is_the_length_of_the_known_path(age):
    found = unstarted()
    drive(found, range(50))
    found.on_measurement(fix(4.9 - age))
    estimate = found.estimate()
    assert estimate.stamp == BEGIN + 49 * PERIOD
    assert math.sqrt(estimate.P[0, 0]) == pytest.approx(0.4 * 4.9, rel=0.01)


@pytest.mark.parametrize("ahead", [5.0, 1e9])
def test_a_fix_ahead_of_the_odometry_does_not_start_the_filter(ahead):
    found = unstarted()
    found.on_measurement(fix(ahead))  # before any odometry
    assert drive(found, range(50)) == ["behind the first fix"] + ["no fix yet"] * 49
    for number in range(50, 100):
        with pytest.raises(BadMessageError, match=r"ahead of the odometry: by .* \(chrony\)"):
            found.on_measurement(fix(0.1 * number + ahead))
        assert drive(found, [number]) == ["no fix yet"]
    found.on_measurement(fix(9.95))
    assert drive(found, range(100, 110)) == []


def test_initialise_with_the_stamp_of_another_clock_uses_the_stamp_of_the_odometry():
    found = unstarted()
    drive(found, range(10), v=0.0)
    found.initialise(Pose(1.0, 2.0, 0.5), SURE, BEGIN + 60 * 10**9)
    assert drive(found, range(10, 20)) == []
    assert found.estimate().pose.x > 1.0


def stepped(step, acts_for=math.inf):
    """Drive straight, with a clock that is set by ``step`` [s] after 3 s.

    Return the filter and one row for each odometry: number, and kind of the error or position error and deviation.
    """
    found, rows = unstarted(), []
    found.time_restarts = False
    found.on_measurement(fix(0.0))
    for number in range(1, 80):
        at = number >= 30
        try:
            estimate = found.on_odometry(odometry(number, step=step * at), acts_for if number == 30 else math.inf)
        except BadMessageError as error:
            rows.append((number, error.kind))
            continue
        rows.append((number, abs(estimate.pose.x - 0.04 * number), math.sqrt(estimate.P[0, 0])))
        if number % 2 == 0:
            found.on_measurement(fix(0.1 * number + step * at, 0.04 * number + 0.02 * math.sin(number)))
    return found, rows


@pytest.mark.parametrize("step", [-0.2, -0.95, -5.0, -2000.0])
def test_after_the_clock_was_set_back_one_odometry_is_dropped_and_the_estimate_stays_right(step):
    found, rows = stepped(step)
    assert [row[1] for row in rows if len(row) == 2] == ["out of order"]
    assert found.clock_set_back == 1
    assert all(error < 3.0 * sigma + 0.01 for _, error, sigma in (row for row in rows if len(row) == 3))
    assert rows[-1][2] < 0.03


@pytest.mark.parametrize("step", [0.3, 30.0, 1e6])
def test_after_the_clock_was_set_forward_the_estimate_is_uncertain_until_the_next_fix(step):
    _, rows = stepped(step, acts_for=0.1)
    assert all(error < 3.0 * sigma + 0.01 for _, error, sigma in rows)
    assert rows[29][2] == pytest.approx(0.4 * min(step, 1.0), rel=0.1)
    assert rows[-1][2] < 0.03


def test_single_messages_out_of_order_do_not_set_the_clock_back():
    found = unstarted()
    found.on_measurement(fix(0.0))
    for number in range(1, 60):
        assert drive(found, [number]) == []
        if number > 10:
            assert drive(found, [number - 3]) == ["out of order"]
    assert found.clock_set_back == 0


@pytest.mark.parametrize("is_late", [False, True])
def test_a_gyro_of_the_wrong_sign_is_detected_within_five_seconds_of_motion(is_late):
    found = stamped.fresh(use_gyro=True, filter="ekf")
    for number in range(1, 200):
        turns = number % 10 < 3
        omega = 0.6 if turns else 0.0
        sample = stamped.GyroSample(number * PERIOD, -omega, 1e-4)
        if not is_late:
            found.on_gyro(sample)
        found.on_odometry(stamped.odometry(number, 0.0, omega))
        if is_late:
            found.on_gyro(sample)
        if found.turns.contradiction() == "opposed":
            break
    assert 0.3 * number * 0.1 < 5.0
