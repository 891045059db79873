"""Fusion in the order of stamps: whatever the order of arrival, the same estimate."""

import contextlib
import math

import numpy as np
import pytest
from filter_runs import R_FIX, build_measurement, numbers_of, odometry_step
from hypothesis import given, settings
from hypothesis import strategies as st

from diffbot_control.filter.gyro import GyroSample
from diffbot_control.filter.localization import Localization
from diffbot_control.filter.localization_config import LocalizationConfig
from diffbot_control.filter.measurements.measurement import key_of
from diffbot_control.filter.options import FILTERS, FilterConfig
from diffbot_control.ros.sensors.sensor import Reading, fuse
from diffbot_core.errors import BadMessageError
from diffbot_core.geometry import Pose
from diffbot_core.kinematics import Twist

MS = 10**6
PERIOD = 100 * MS
START = Pose(1.0, 2.0, 3.0)
P0 = np.diag([0.2, 0.3, 0.03])
R_POSE = np.array([[0.03, 0.01, 0.0], [0.01, 0.03, 0.0], [0.0, 0.0, 0.01]])


def plain(history=1.0):
    """The filter of three states that believes everything: what the textbook below does."""
    return LocalizationConfig(history, FilterConfig(filter="ekf", gate_probability=1.0, detect_correlation=False))


def odometry(number, v=1.2, omega=0.7):
    """Return the odometry of one period, its end stamped ``number`` periods after 0."""
    return odometry_step(number * PERIOD, Twist(v, omega), 4e-3, 1e-3, 0.02)


def fix(stamp, seed=0):
    rng = np.random.default_rng([stamp, seed])
    return build_measurement(stamp, np.array([1.0, 2.0, 3.0]) + rng.normal(0.0, 0.2, 3), R_POSE)


def heading(stamp):
    rng = np.random.default_rng([stamp, 99])
    return build_measurement(stamp, 3.0 + rng.normal(0.0, 0.1, 1), np.array([[0.02]]))


def fresh(history=1.0):
    localization = Localization(plain(history))
    localization.initialise(START, P0, 0)
    return localization


class Textbook:
    """A Kalman filter over a list of events sorted beforehand: no late, no early, no second arrivals."""

    def __init__(self):
        self.x, self.P = np.array(START), P0.copy()

    def predict(self, step, dt, whole):
        x, y, theta = self.x
        v, omega = step.twist
        middle = theta + 0.5 * omega * dt
        c, s = math.cos(middle), math.sin(middle)
        self.x = np.array([x + v * dt * c, y + v * dt * s, theta + omega * dt])
        F = np.array([[1.0, 0.0, -v * dt * s], [0.0, 1.0, v * dt * c], [0.0, 0.0, 1.0]])
        G = np.array([[dt * c, -0.5 * v * dt**2 * s], [dt * s, 0.5 * v * dt**2 * c], [0.0, dt]])
        var_v, cov, var_omega = step.covariance
        M = np.array([[var_v, cov], [cov, var_omega]])
        self.P = F @ self.P @ F.T + G @ (M * whole / dt) @ G.T

    def update(self, measurement):
        size = numbers_of(measurement).size
        H = np.eye(3)[3 - size :]
        innovation = numbers_of(measurement) - H @ self.x
        innovation[-1] = math.remainder(innovation[-1], 2.0 * math.pi)
        K = self.P @ H.T @ np.linalg.inv(H @ self.P @ H.T + measurement.R)
        self.x = self.x + K @ innovation
        self.P = (np.eye(3) - K @ H) @ self.P

    def run(self, steps, measurements):
        waiting, start = sorted(measurements, key=lambda one: one.stamp), 0
        for step in steps:
            now = start
            while waiting and waiting[0].stamp <= step.stamp:
                measurement = waiting.pop(0)
                if measurement.stamp > now:
                    self.predict(step, (measurement.stamp - now) * 1e-9, (step.stamp - start) * 1e-9)
                    now = measurement.stamp
                self.update(measurement)
            if step.stamp > now:
                self.predict(step, (step.stamp - now) * 1e-9, (step.stamp - start) * 1e-9)
            start = step.stamp
        return self


def assert_equal_estimates(localization, x, P, tolerance=0.0):
    found = localization.estimate()
    np.testing.assert_allclose(found.pose[:2], x[:2], rtol=0.0, atol=tolerance)
    assert abs(math.remainder(found.pose.theta - x[2], 2.0 * math.pi)) <= tolerance
    np.testing.assert_allclose(found.P, P, rtol=0.0, atol=tolerance)


def in_order(steps, measurements):
    """Deliver every measurement just before the odometry that covers it."""
    localization = fresh()
    waiting = sorted(measurements, key=lambda one: one.stamp)
    for step in steps:
        while waiting and waiting[0].stamp <= step.stamp:
            localization.on_measurement(waiting.pop(0))
        localization.on_odometry(step)
    return localization


# Stamps in ms within a second, some on odometry stamps (0, 100, ...), and an arrival up to 0.9 s after each.
EVENTS = st.lists(
    st.tuples(st.integers(0, 1000) | st.sampled_from(range(0, 1001, 100)), st.booleans(), st.integers(0, 900)),
    min_size=1,
    max_size=12,
    unique_by=lambda event: (event[0], event[1]),
)


@settings(max_examples=50)
@given(EVENTS)
def test_in_order_it_is_the_textbooks_filter(events):
    # One odometry is lost: the next bridges it.
    steps = [odometry(number, 1.2, 0.7 - 0.1 * number) for number in range(1, 12) if number != 5]
    measurements = [(heading if is_heading else fix)(ms * MS) for ms, is_heading, _ in events]
    textbook = Textbook().run(steps, measurements)
    assert_equal_estimates(in_order(steps, measurements), textbook.x, textbook.P, 1e-9)


@pytest.mark.parametrize("history", [0.0, 1.0])
def test_what_is_older_than_the_history_is_refused_and_changes_nothing(history):
    localization = fresh(history)
    for number in range(1, 81):
        localization.on_odometry(odometry(number))
    before = localization.estimate()
    # The step that the edge of the history falls into may still be there: one period more.
    with pytest.raises(BadMessageError, match="too old"):
        localization.on_measurement(fix(80 * PERIOD - round(history * 1e9) - PERIOD - 1))
    assert_equal_estimates(localization, before.pose, before.P)


def test_a_sender_with_a_wrong_clock_does_not_shut_the_others_out():
    # An hour ahead, its headings wait for odometry that will not come soon, and fill all places.
    localization, alone = fresh(), fresh()
    for number in range(1500):
        with contextlib.suppress(BadMessageError):
            localization.on_measurement(heading(3600 * 10**9 + number * PERIOD))
    for number in range(1, 31):
        for one in (localization, alone):
            one.on_measurement(fix(number * PERIOD - 30 * MS))
            one.on_measurement(fix(number * PERIOD))
            one.on_odometry(odometry(number))
    assert_equal_estimates(localization, alone.estimate().pose, alone.estimate().P)


def test_an_odometry_sent_again_is_answered_without_moving():
    localization = fresh()
    first = localization.on_odometry(odometry(1))
    again = localization.on_odometry(odometry(1, v=9.0))
    assert again.stamp == first.stamp == PERIOD
    assert again.pose == first.pose
    np.testing.assert_array_equal(again.P, first.P)
    assert again.odometry == odometry(1)
    # What was measured in between is in the second answer.
    localization.on_measurement(fix(PERIOD))
    assert localization.on_odometry(odometry(1)).pose != first.pose


@pytest.mark.parametrize(("number", "kind"), [(2, "time jumped back"), (10**5, "time jumped ahead")])
def test_time_that_jumps_resets(number, kind):
    localization = fresh()
    for one in range(1, 50):
        localization.on_odometry(odometry(one))
    localization.on_measurement(fix(60 * PERIOD))
    with pytest.raises(BadMessageError, match=kind):
        localization.on_odometry(odometry(number))
    assert not localization.initialised
    with pytest.raises(BadMessageError, match="no fix yet"):
        localization.on_odometry(odometry(number + 1))
    # The next fix starts anew, and nothing of the old time is left waiting.
    again = fix((number + 1) * PERIOD)
    localization.on_measurement(again)
    reference = Localization(plain())
    reference.initialise(again.pose, R_POSE, (number + 1) * PERIOD)
    for one in range(number + 1, number + 70):
        localization.on_odometry(odometry(one))
        reference.on_odometry(odometry(one))
    assert_equal_estimates(localization, reference.estimate().pose, reference.estimate().P)


def test_initialise_moves_the_filter_but_not_its_time():
    localization = fresh()
    localization.on_odometry(odometry(1))
    localization.on_odometry(odometry(2))
    localization.on_measurement(fix(250 * MS))
    localization.initialise(Pose(7.0, 8.0, -1.0 + 4.0 * math.pi), np.eye(3), 500 * PERIOD)
    found = localization.estimate()
    assert (found.stamp, found.pose) == (2 * PERIOD, pytest.approx((7.0, 8.0, -1.0)))
    np.testing.assert_array_equal(found.P, np.eye(3))
    # What was measured before belongs to the old place: neither kept nor taken.
    with pytest.raises(BadMessageError):
        localization.on_measurement(fix(150 * MS))
    localization.on_odometry(odometry(3))
    twin = Localization(plain())
    twin.initialise(Pose(7.0, 8.0, -1.0), np.eye(3), 2 * PERIOD)
    assert_equal_estimates(localization, *twin.on_odometry(odometry(3))[1:3], 1e-12)


@pytest.mark.parametrize("late_ms", [-50, 0, 250])
def test_a_measurement_that_is_sent_again_is_refused_and_changes_nothing(late_ms):
    localization, once = fresh(), fresh()
    measurement = fix(10 * PERIOD - late_ms * MS)
    for one in (localization, once):
        for number in range(1, 11):
            one.on_odometry(odometry(number))
        one.on_measurement(measurement)
    for _ in range(3):
        with pytest.raises(BadMessageError, match="duplicate"):
            localization.on_measurement(build_measurement(measurement.stamp, numbers_of(measurement), measurement.R))
    # Nor later, when what followed is computed again.
    for one in (localization, once):
        one.on_measurement(fix(10 * PERIOD - 300 * MS, seed=5))
        one.on_odometry(odometry(11))
    with pytest.raises(BadMessageError, match="duplicate"):
        localization.on_measurement(measurement)
    assert_equal_estimates(localization, once.estimate().pose, once.estimate().P)


def test_history_and_keys_do_not_grow_for_ever_whatever_stamp_comes_far_ahead():
    localization = fresh(history=0.5)
    localization.on_measurement(heading(10**9 * 10**9))
    blind = np.array([[1e6]])
    for number in range(1, 111):
        for part in range(100):
            localization.on_measurement(build_measurement((number - 1) * PERIOD + part * MS + MS, np.zeros(1), blind))
        localization.on_odometry(odometry(number))
        assert len(localization._steps) <= 7
    assert len(localization._keys) <= 10_000
    # Sent again within the history, each is still known.
    with pytest.raises(BadMessageError, match="duplicate"):
        localization.on_measurement(build_measurement(109 * PERIOD + MS, np.zeros(1), blind))


def landmark_run(**options):
    """Return a filter of landmarks and a gyro after three seconds of driving with fixes."""
    config = FilterConfig(use_gyro=True, **options)
    found = Localization(LocalizationConfig(filter=config), landmarks=True)
    found.initialise(START, P0, 0)
    for number in range(1, 31):
        found.on_gyro(GyroSample(number * PERIOD, 0.7, 1e-4))
        if number % 5 == 0:
            found.on_measurement(fix(number * PERIOD - 30 * MS))
        found.on_odometry(odometry(number))
    return found


def cloud(stamp, pose, count, misread=0):
    """Return the measurements of ``count`` landmarks from ``pose``, the first ``misread`` of them far too long."""
    rng, found = np.random.default_rng([stamp, count]), []
    for index in range(count):
        point = 9.0 * math.cos(2.4 * index), 9.0 * math.sin(2.4 * index)
        dx, dy = point[0] - pose[0], point[1] - pose[1]
        z = np.array([math.hypot(dx, dy), math.remainder(math.atan2(dy, dx) - pose[2], math.tau)])
        z += rng.normal(0.0, 0.02, 2)
        z[0] += 5.0 * (index < misread)
        found.append(build_measurement(stamp, z, np.diag([4e-4, 4e-4]), point))
    return sorted(found, key=key_of)


def assert_same_state(one, other):
    assert one.estimate().pose == other.estimate().pose
    for found, expected in zip(one.filter.memory.belief, other.filter.memory.belief, strict=True):
        np.testing.assert_array_equal(found, expected)
    assert one.filter.memory.gate == other.filter.memory.gate
    assert one.filter.memory.landmarks.means == other.filter.memory.landmarks.means
    assert one.monitor.values() == other.monitor.values()
    assert one.contradiction == other.contradiction


@pytest.mark.parametrize("variant", FILTERS)
@pytest.mark.parametrize("late_ms", [0, 250, 330])
def test_a_late_cloud_gives_the_same_bits_as_its_landmarks_one_by_one(variant, late_ms):
    whole, one_by_one = (landmark_run(filter=variant, relocation_timeout=0.25) for _ in range(2))
    for number in range(30, 45):
        stamp = number * PERIOD - late_ms * MS
        # Nothing but misread ranges for so long resets the pose.
        measured = cloud(stamp, whole.estimate().pose, 12, misread=12 if 33 <= number < 38 else 1)
        assert whole.on_measurements(measured) == []
        for one in measured:
            one_by_one.on_measurement(one)
        assert_same_state(whole, one_by_one)
        for found in (whole, one_by_one):
            found.on_gyro(GyroSample((number + 1) * PERIOD, 0.7, 1e-4))
            found.on_odometry(odometry(number + 1))
    assert_same_state(whole, one_by_one)
    assert whole.monitor.sensors["landmarks"].rejected > 15
    assert whole.monitor.sensors["landmarks"].relocated > 0


def test_the_estimate_does_not_depend_on_the_order_in_a_late_message():
    measured = cloud(27 * PERIOD, (1.0, 2.0, 3.0), 12)
    forwards, backwards = landmark_run(), landmark_run()
    forwards.on_measurements([*measured, fix(25 * PERIOD)])
    backwards.on_measurements([fix(25 * PERIOD), *reversed(measured)])
    assert_same_state(forwards, backwards)


def test_each_bad_measurement_of_a_late_message_is_dropped_and_the_others_are_fused():
    found, clean = landmark_run(), landmark_run()
    good, old = cloud(28 * PERIOD, (1.0, 2.0, 3.0), 4), cloud(PERIOD, (1.0, 2.0, 3.0), 1)
    broken = build_measurement(28 * PERIOD, np.array([math.nan, 0.1]), R_FIX[:2, :2], (1.0, 1.0))
    errors = found.on_measurements([good[0], broken, good[1], *old, good[0], *good[2:]])
    assert [one.kind for one in errors] == ["measurement not finite", "too old", "duplicate"]
    assert clean.on_measurements(good) == []
    assert_same_state(found, clean)


def test_a_late_message_repeats_the_history_once():
    found, predicted = landmark_run(), []
    predict = found.filter.predict
    found.filter.predict = lambda *motion: (predicted.append(motion), predict(*motion))
    dropped = []
    fuse(Reading(cloud(29 * PERIOD - 50 * MS, (1.0, 2.0, 3.0), 100)), found, dropped.append)
    # The step that the stamp is in has two parts, and so has the next, in which there is a fix.
    assert (len(predicted), dropped) == (4, [])
    predicted.clear()
    found.on_gyro(GyroSample(28 * PERIOD - 50 * MS, 0.7, 1e-4))
    assert len(predicted) == 5
