"""Fusion in the order of stamps: the estimate does not depend on the order of arrival."""

import contextlib
import math

import numpy as np
import pytest
import stamped
from filter_runs import SEPARATION, assert_state, build_motion, jacobian, moved, process_noise, textbook, wrapped
from hypothesis import given, settings
from hypothesis import strategies as st
from stamped import MS, PERIOD, compass, deliver, fix, fresh, odometry, sighting

from diffbot_control.filter import ekf, history
from diffbot_control.filter.config import LocalizationConfig
from diffbot_control.filter.localization import Localization
from diffbot_control.filter.measurement import GyroSample, Measurement, landmark
from diffbot_control.filter.models import HEADING
from diffbot_core.errors import BadMessageError
from diffbot_core.geometry import Point, Pose

# Some stamps are ends of steps, where the measurement may arrive while its step is the newest.
STAMPS = st.one_of(st.integers(1, 2000), st.integers(1, 20).map(lambda step: 100 * step))
EVENTS = st.lists(
    st.tuples(STAMPS, st.sampled_from(sorted(stamped.MAKERS)), st.integers(0, 900)),
    min_size=3,
    max_size=30,
    unique_by=lambda event: event[:2],
)


@pytest.mark.parametrize(("variant", "delay"), [("ekf_calibrating", 0.03), ("ekf_fnn_calibrating", 0.0)])
@settings(max_examples=25)
@given(EVENTS, st.randoms(use_true_random=False))
def test_the_memory_does_not_depend_on_the_order_of_arrival(variant, delay, events, random):
    made = [(stamped.MAKERS[kind](ms * MS), late) for ms, kind, late in events]
    late = [(one.stamp + late * MS, random.choice((0.25, 0.75)) + 1e-3 * random.random(), one) for one, late in made]
    keys = sorted(made, key=lambda one: one[0].key if isinstance(one[0], Measurement) else (one[0].stamp, ""))
    punctual = [(one.stamp, 1e-4 * rank, one) for rank, (one, _) in enumerate(keys)]
    found, expected = (
        deliver(fresh(landmarks=stamped.CIRCLE[:2], delay=delay, **{**stamped.EVERYTHING, "filter": variant}), one)
        for one in (late, punctual)
    )
    np.testing.assert_allclose(found.filter.memory, expected.filter.memory, rtol=0.0, atol=1e-9)
    assert found.estimate().stamp == expected.estimate().stamp == 25 * PERIOD
    assert sum(map(sum, (one.values() for one in found.outcomes.values()))) == sum(
        isinstance(one, Measurement) for one, _ in made
    )


@settings(max_examples=25)
@given(EVENTS)
def test_the_fusion_of_fixes_and_headings_is_the_textbook_filter(events):
    # One odometry is lost, and the next one covers its interval.
    steps = [odometry(n, 1.2, 0.7 - 0.1 * n) for n in range(1, 22) if n != 5]
    ones = [stamped.MAKERS[kind](ms * MS) for ms, kind, _ in events if kind in ("fix", "compass")]
    found, x, P, now = fresh(**stamped.PLAIN), stamped.START, stamped.P0, 0
    for one in ones:
        found.on_measurement(one)
    for start, step in zip([0, *(one.stamp for one in steps)], steps, strict=False):
        found.on_odometry(step)
        for cut in sorted({one.stamp for one in ones if start < one.stamp <= step.stamp} | {step.stamp}):
            dt = (cut - now) * 1e-9
            # The variances of the parts of a message add up to the variance of the message.
            M = np.array(step.covariance) * (step.stamp - start) / (cut - now)
            motion, now = build_motion(*step.twist, dt, *M), cut
            F = jacobian(lambda s: moved(s, motion), x)  # noqa: B023
            x, P = moved(x, motion), F @ P @ F.T + process_noise(x, motion)
            for one in (one for one in ones if one.stamp == cut):
                H, noise = (np.eye(3)[2:], one.R) if one.kind == HEADING else (np.eye(3), stamped.R)
                y = one.z - H @ x
                y[-1] = wrapped(y[-1])
                x, P = x + P @ H.T @ np.linalg.solve(H @ P @ H.T + noise, y), textbook(x, P, y, H, noise)[1]
    assert_state(found.filter, x, P, 1e-7)


def everything_after_a_drive():
    """Return a filter with all states after 0.8 s with fixes and a gyro."""
    found = fresh(landmarks=stamped.CIRCLE, **{**stamped.EVERYTHING, "relocation_fixes": 100})
    for number in range(1, 9):
        found.on_gyro(GyroSample(number * PERIOD, 0.7, 1e-4))
        if number % 4 == 0:
            found.on_measurement(fix(number * PERIOD - 30 * MS))
        found.on_odometry(odometry(number))
    return found


def assert_same(one, other):
    np.testing.assert_array_equal(one.filter.memory, other.filter.memory)
    assert (one.outcomes, one.contradiction, one.slips) == (other.outcomes, other.contradiction, other.slips)
    assert one.estimate().pose == other.estimate().pose


def test_a_late_message_computes_the_history_again_only_once(monkeypatch):
    found, predicted, predict = everything_after_a_drive(), [], ekf.predict
    monkeypatch.setattr(ekf, "predict", lambda *motion: (predicted.append(motion), predict(*motion)))
    assert found.on_measurements(sighting(650 * MS, i) for i in range(50)) == []
    # The step with the stamp has two parts, and so has the next step, which contains a fix.
    assert len(predicted) == 4
    predicted.clear()
    found.on_gyro(GyroSample(550 * MS, 0.7, 1e-4))
    assert len(predicted) == 5


def test_each_bad_measurement_of_a_message_is_dropped_with_an_error_and_the_others_are_fused():
    found, clean = everything_after_a_drive(), everything_after_a_drive()
    good, two = [sighting(650 * MS, 0), sighting(550 * MS, 1), fix(250 * MS)], stamped.R[:2, :2]
    bad = {
        "measurement not finite": landmark(650 * MS, math.nan, 0.1, two, stamped.CIRCLE[0]),
        "landmark not on the map": landmark(650 * MS, 1.0, 0.1, two, Point(0.0, 0.0)),
        "unknown source": fix(650 * MS, "fixes of nobody"),
        "too old": landmark(-300 * MS, 9.0, 0.1, two, stamped.CIRCLE[0]),
        "duplicate": good[0],
    }
    errors = found.on_measurements([good[0], *bad.values(), *good[1:]])
    assert [one.kind for one in errors] == list(bad)
    for one in reversed(good):
        clean.on_measurement(one)
    for one in (found, clean):
        one.on_odometry(odometry(9))
    assert_same(found, clean)


@pytest.mark.parametrize("length", [0.0, 1.0])
def test_a_measurement_before_the_history_is_dropped(length):
    found = fresh(length)
    for number in range(1, 81):
        found.on_odometry(odometry(number))
    before = found.filter.memory.copy()
    # The history may contain the whole step at its limit, so it may be one period longer.
    with pytest.raises(BadMessageError, match="too old"):
        found.on_measurement(fix(80 * PERIOD - round(length * 1e9) - PERIOD - 1))
    np.testing.assert_array_equal(found.filter.memory, before)
    found.on_measurement(fix(80 * PERIOD - round(length * 1e9)))


@pytest.mark.parametrize("late_ms", [-50, 0, 250])
def test_a_duplicate_is_dropped(late_ms):
    found, once = fresh(), fresh()
    for one in (found, once):
        for number in range(1, 11):
            one.on_odometry(odometry(number))
        one.on_measurement(fix(10 * PERIOD - late_ms * MS))
    for later in (11, 12):
        with pytest.raises(BadMessageError, match="duplicate"):
            found.on_measurement(fix(10 * PERIOD - late_ms * MS))
        for one in (found, once):
            one.on_measurement(fix(10 * PERIOD - 300 * MS, seed=later))
            one.on_odometry(odometry(later))
    assert_same(found, once)


def test_a_sender_with_a_wrong_clock_does_not_block_other_senders():
    # Its headings are an hour ahead, so they wait for their odometry and fill the queue.
    found, alone = fresh(), fresh()
    for number in range(1500):
        with contextlib.suppress(BadMessageError):
            found.on_measurement(compass(3600 * 10**9 + number * PERIOD))
    for number in range(1, 31):
        for one in (found, alone):
            one.on_measurement(fix(number * PERIOD - 30 * MS))
            one.on_measurement(fix(number * PERIOD))
            one.on_odometry(odometry(number))
    assert_same(found, alone)


def test_history_and_keys_are_bounded_even_after_a_stamp_far_ahead(monkeypatch):
    monkeypatch.setattr(history, "_MAX_KEYS", 500)
    found = fresh(0.5)
    found.on_measurement(compass(10**18))
    for number in range(1, 61):
        for part in range(10):
            found.on_measurement(compass((number - 1) * PERIOD + part * MS + MS))
        found.on_odometry(odometry(number))
    assert len(found._history.steps) <= 7
    assert len(found._history._keys) <= 500
    # Duplicates within the history are still recognised.
    with pytest.raises(BadMessageError, match="duplicate"):
        found.on_measurement(compass(56 * PERIOD + MS))


def test_a_repeated_odometry_is_answered_without_a_motion():
    found = fresh()
    first, again = found.on_odometry(odometry(1)), found.on_odometry(odometry(1, v=9.0))
    assert (again.stamp, again.pose, again.odometry) == (PERIOD, first.pose, odometry(1))
    # The second answer contains measurements that arrived in between.
    found.on_measurement(fix(PERIOD))
    assert found.on_odometry(odometry(1)).pose != first.pose
    found.on_odometry(odometry(2))
    with pytest.raises(BadMessageError, match="out of order"):
        found.on_odometry(odometry(1))


@pytest.mark.parametrize(("number", "kind"), [(2, "time jumped back"), (10**5, "time jumped ahead")])
def test_a_jump_of_time_resets_the_filter(number, kind):
    found, twin = fresh(), fresh()
    for one in range(1, 50):
        found.on_odometry(odometry(one))
    found.on_measurement(fix(60 * PERIOD))
    with pytest.raises(BadMessageError, match=kind):
        found.on_odometry(odometry(number))
    for use in (found.on_odometry, lambda _: found.estimate(), lambda one: found.on_measurement(compass(one.stamp))):
        with pytest.raises(BadMessageError, match="no fix yet"):
            use(odometry(number + 1))
    # The next fix starts the filter, and measurements that waited before the jump are gone.
    again = fix((number + 1) * PERIOD)
    found.on_measurement(again)
    twin.reset()
    twin.initialise(Pose(*again.z), stamped.R, again.stamp)
    for one in range(number + 1, number + 70):
        assert found.on_odometry(odometry(one)).pose == twin.on_odometry(odometry(one)).pose


def test_initialise_changes_the_pose_but_not_the_time():
    found, twin, place = fresh(**stamped.PLAIN), fresh(**stamped.PLAIN), Pose(7.0, 8.0, -1.0)
    for number in (1, 2):
        found.on_odometry(odometry(number))
    found.on_measurement(fix(250 * MS))
    found.initialise(place._replace(theta=-1.0 + 4.0 * math.pi), np.eye(3), 500 * PERIOD)
    assert (found.estimate().stamp, found.estimate().pose) == (2 * PERIOD, pytest.approx(place))
    # Measurements before the change belong to the old pose, so they are dropped.
    with pytest.raises(BadMessageError, match="too old"):
        found.on_measurement(fix(150 * MS))
    twin.reset()
    twin.initialise(place, np.eye(3), 2 * PERIOD)
    assert found.on_odometry(odometry(3)).pose == pytest.approx(twin.on_odometry(odometry(3)).pose, abs=1e-12)


def test_measurements_before_the_first_odometry_are_dropped_and_counted():
    found = Localization(LocalizationConfig(), SEPARATION)
    found.initialise(Pose(*stamped.START), stamped.P0)  # without a stamp, as from the state file
    for number in range(1, 6):
        found.on_measurement(fix(number * MS))
    found.on_odometry(odometry(1))
    assert (found.dropped_before_odometry, found.estimate().pose) == (5, tuple(stamped.START))
