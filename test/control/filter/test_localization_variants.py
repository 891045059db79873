"""Late and unordered measurements in every variant of the filter: to the bit what they give in order."""

import math

import numpy as np
import pytest
from filter_runs import SEPARATION, build_measurement, landmark, numbers_of, odometry_step, wrapped
from hypothesis import given, settings
from hypothesis import strategies as st

from diffbot_control.filter.adaptation import new_adaptation
from diffbot_control.filter.belief import ErrorEstimate
from diffbot_control.filter.gate import new_gate
from diffbot_control.filter.gyro import GyroSample
from diffbot_control.filter.localization import Localization
from diffbot_control.filter.localization_config import LocalizationConfig
from diffbot_control.filter.measurements import Heading, LandmarkMeasurement, PoseFix
from diffbot_control.filter.options import EKF, FNN_CALIBRATING, FilterConfig
from diffbot_core.errors import BadMessageError
from diffbot_core.geometry import Pose
from diffbot_core.kinematics import Twist

BOTH = pytest.mark.parametrize("variant", [EKF, FNN_CALIBRATING])
MS = 10**6
PERIOD = 100 * MS
STEPS = 25
CARRIED = np.array([3.6, -1.0, 1.0])
P0 = np.diag([0.02, 0.03, 0.01])
R_FIX = np.diag([0.03, 0.02, 0.01])


def localization(variant, history=1.0, **options):
    made = Localization(LocalizationConfig(history, FilterConfig(filter=variant, **options)), SEPARATION)
    made.initialise(Pose(0.0, 0.0, 3.0), P0, 0)
    return made


def odometry(number, v=1.2, omega=0.7):
    return odometry_step(number * PERIOD, Twist(v, omega), 4e-3, 1e-3, 0.02)


def circle(pose, t):
    x, y, theta = pose
    end, radius = theta + 0.7 * t, 1.2 / 0.7
    return np.array(
        [x + radius * (math.sin(end) - math.sin(theta)), y + radius * (math.cos(theta) - math.cos(end)), end]
    )


def truth(stamp):
    """A circle; the robot is carried away after 0.8 s."""
    t = stamp * 1e-9
    start = np.array([0.0, 0.0, 3.0])
    return circle(start, t) if t <= 0.8 else circle(circle(start, 0.8) + CARRIED, t - 0.8)


def fix(stamp, offset=(0.0, 0.0, 0.0), seed=0):
    rng = np.random.default_rng([stamp, 1, seed])
    z = truth(stamp) + np.sqrt(R_FIX.diagonal()) * rng.normal(size=3) + offset
    return build_measurement(stamp, np.array([z[0], z[1], wrapped(z[2])]), R_FIX)


def heading(stamp):
    z = truth(stamp)[2] + 0.1 * np.random.default_rng([stamp, 2]).normal()
    return build_measurement(stamp, np.array([wrapped(z)]), np.array([[0.01]]))


def sighting(stamp):
    seen = landmark(truth(stamp), (4.0, 1.0), np.diag([0.01, 0.004]))
    noise = np.random.default_rng([stamp, 3, 0]).normal(0.0, 0.1, 2)
    return build_measurement(stamp, numbers_of(seen) + noise * (1.0, 0.5), seen.R, seen.landmark)


MAKERS = (fix, fix, heading, sighting)


def flat(value):
    """All numbers of a memory, in order."""
    if value is None:
        return [None]
    if isinstance(value, np.ndarray):
        return value.reshape(-1).tolist()
    if isinstance(value, tuple):
        return [number for one in value for number in flat(one)]
    return [value]


def deliver(made, arrivals):
    for _, _, arrived in sorted(arrivals, key=lambda one: one[:2]):
        (made.on_measurement if isinstance(arrived, (PoseFix, Heading, LandmarkMeasurement)) else made.on_odometry)(
            arrived
        )
    return made


def with_odometry(arrivals):
    return [*arrivals, *((number * PERIOD, 0.5, odometry(number)) for number in range(1, STEPS + 1))]


# Some on the ends of steps, where a measurement may come while its step is the newest.
STAMPS = st.one_of(st.integers(1, 2000), st.integers(1, 20).map(lambda step: 100 * step))
EVENTS = st.lists(
    st.tuples(STAMPS, st.integers(0, 3), st.integers(0, 900)),
    min_size=3,
    max_size=30,
    unique_by=lambda event: (event[0], event[1] in (0, 1), event[1]),
)
OPTIONS = {"relocation_fixes": 2, "relocation_timeout": 0.4, "gate_probability": 0.99}


@BOTH
@settings(max_examples=25)
@given(EVENTS, st.randoms(use_true_random=False))
def test_late_measurements_give_what_they_give_in_order(variant, events, random):
    measurements = {(ms, MAKERS[kind]): MAKERS[kind](ms * MS) for ms, kind, _ in events}
    delays = {(ms, MAKERS[kind]): delay for ms, kind, delay in events}
    arrivals = [
        (one.stamp + delays[name] * MS, random.choice((0.25, 0.75)) + 1e-3 * random.random(), one)
        for name, one in measurements.items()
    ]
    # Each before the odometry that covers it; of equal stamps the fix first, then by value.
    order = sorted(measurements.values(), key=lambda one: (one.stamp, -numbers_of(one).size, *one.z))
    in_order = [(one.stamp, 0.0001 * rank, one) for rank, one in enumerate(order)]
    late, punctual = (deliver(localization(variant, **OPTIONS), with_odometry(one)) for one in (arrivals, in_order))
    # To the bit, and all of it: belief with the wheels, candidate, gate and adaptation.
    assert flat(late.filter.memory) == flat(punctual.filter.memory)
    assert late.estimate().stamp == punctual.estimate().stamp


def test_a_late_measurement_is_counted_once_and_the_others_not_again():
    made = localization("ekf", relocation_timeout=60.0, relocation_fixes=100)
    far = (50.0, 0.0, 0.0)
    for number in range(1, 8):
        made.on_measurement(fix(number * PERIOD - 60 * MS))
        if number % 2 == 0:
            made.on_measurement(fix(number * PERIOD - 10 * MS, far, number))
        made.on_odometry(odometry(number))
    assert made.monitor.sensors["fixes"].rejected == 3
    assert len(made.monitor._window) == 7
    for count, ms in enumerate((120, 130, 140), 1):
        made.on_measurement(heading(ms * MS))
        assert made.monitor.sensors["fixes"].rejected == 3
        assert len(made.monitor._window) == 7 + count
    made.on_measurement(fix(125 * MS, far))
    assert made.monitor.sensors["fixes"].rejected == 4
    assert len(made.monitor._window) == 10


def test_a_new_pose_keeps_wheels_and_adaptation_and_a_reset_forgets_both_and_neither_keeps_the_gate():
    made = localization("ekf_fnn_calibrating")
    for number in range(1, 8):
        made.on_measurement(fix(number * PERIOD - MS, (0.5 * (-1) ** number, 0.0, 0.0)))
        made.on_odometry(odometry(number))
    wheels = np.array([0.03, -0.02, 0.01])
    P = np.array([[4e-6, 1e-6, 0.0], [1e-6, 3e-6, 0.0], [0.0, 0.0, 2e-6]])
    for seed, forget in enumerate((lambda: made.initialise(Pose(7.0, 8.0, -1.0), np.eye(3)), made.reset)):
        made.on_measurement(fix(7 * PERIOD, (90.0, 0.0, 0.0), seed))
        made.filter.set_wheels(ErrorEstimate(wheels, P))
        learnt, gate = made.filter.memory.adaptation, made.filter.memory.gate
        assert made.filter.memory.candidate is not None
        assert gate.fixes.rejected
        forget()
        assert made.filter.memory.candidate is None
        assert made.filter.memory.gate == new_gate()
        assert made.monitor.nis() is None
        if made.initialised:
            x, whole = made.filter.memory.belief
            np.testing.assert_array_equal(x, [7.0, 8.0, -1.0, *wheels])
            np.testing.assert_array_equal(whole[3:, 3:], P)
            assert not whole[3:, :3].any()
            assert made.filter.memory.adaptation == learnt != new_adaptation()
    with pytest.raises(BadMessageError, match="no fix yet"):
        made.estimate()


def test_wheel_separation_and_walk_can_be_changed_at_runtime():
    variant = "ekf_calibrating"
    made = localization(variant)
    made.filter.set_wheels(ErrorEstimate(np.array([0.0, 0.1, 0.0]), 1e-6 * np.eye(3)))
    config = FilterConfig(filter=variant, wheel_radius_walk=0.05)
    made.configure(LocalizationConfig(1.0, config), 0.3)
    found = made.on_odometry(odometry(1, 1.0, 0.0))
    # The right wheel is 10 % larger: 0.1 m/s / 0.3 m for 0.1 s.
    assert found.pose.theta == pytest.approx(3.0 + 0.1 / 0.3 * 0.1)
    assert made.filter.memory.belief.P[4, 4] == pytest.approx(1e-6 + 0.05**2 * 0.1)


def test_what_waits_since_before_the_first_odometry_is_dropped_and_counted():
    made = Localization(LocalizationConfig(), SEPARATION)
    made.initialise(Pose(0.0, 0.0, 3.0), P0)  # as out of a file: without a time
    for number in range(1, 6):
        made.on_measurement(fix(number * MS))
    made.on_odometry(odometry(1))
    assert made.dropped_before_odometry == 5
    assert made.estimate().pose == (0.0, 0.0, 3.0)


@pytest.mark.parametrize("as_configured", [0.0, 0.5, 1.0])
@pytest.mark.parametrize("use_gyro", [False, True])
def test_the_pose_moves_by_the_twist_whatever_the_probability_of_errors(as_configured, use_gyro):
    made = localization("ekf_calibrating", wheels_as_configured=as_configured, wheel_radius_walk=0.0, use_gyro=use_gyro)
    # Smaller than the deviations at the start, and large enough that both hypotheses count.
    errors = np.array([0.006, 0.008, 0.01])
    made.filter.set_wheels(ErrorEstimate(errors, np.diag([0.005, 0.005, 0.01]) ** 2))
    if use_gyro:
        made.on_gyro(GyroSample(PERIOD, 0.7, 1e-4))
    before, step = made.estimate(), odometry(1)
    after = made.on_odometry(step)
    twist, _ = made.twist_of(after, step)
    middle = before.pose.theta + 0.05 * twist.omega
    way = 0.1 * twist.v * np.array([math.cos(middle), math.sin(middle)])
    np.testing.assert_allclose(np.subtract(after.pose[:2], before.pose[:2]), way, atol=2e-6)
    assert after.pose.theta - before.pose.theta == pytest.approx(0.1 * twist.omega, abs=2e-6)
    share = after.average.x[3:6] / made.filter.memory.belief.x[3:6]
    low, high = {0.0: (1.0, 1.0), 0.5: (0.2, 0.8), 1.0: (0.0, 0.0)}[as_configured]
    assert (share >= low - 1e-9).all()
    assert (share <= high + 1e-9).all()
