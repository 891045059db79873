"""A gyro beside the wheels: against a joint filter with the noise as states, biased, and with slip."""

import math
from itertools import count

import numpy as np
import pytest
from filter_runs import R_FIX, SEPARATION, build_motion, covariance, gated_filter, jacobian

from diffbot_control.filter.gyro import GyroSample
from diffbot_control.filter.localization import Localization
from diffbot_control.filter.localization_config import LocalizationConfig
from diffbot_control.filter.measurements.gyro import GyroRate
from diffbot_control.filter.models import TurnRate
from diffbot_control.filter.odometry import OdometryStep
from diffbot_control.filter.options import FilterConfig
from diffbot_control.filter.slip import add_innovation
from diffbot_core.errors import BadMessageError
from diffbot_core.geometry import Pose
from diffbot_core.kinematics import Twist, TwistCovariance

SIGMA, BIAS = 0.005, 0.02
"""[rad/s] white error of the gyro, and its bias"""
STEP = 100_000_000


def moved(state, measured, noise, dt):
    """Midpoint motion of (x, y, theta, e_left, e_right, e_separation, bias), written anew."""
    x, y, theta, left, right, separation, _ = state
    rims = (
        (measured[0] - 0.5 * SEPARATION * measured[1]) * (1.0 + left),
        (measured[0] + 0.5 * SEPARATION * measured[1]) * (1.0 + right),
    )
    v = 0.5 * (rims[0] + rims[1]) + noise[0]
    omega = (rims[1] - rims[0]) / (SEPARATION * (1.0 + separation)) + noise[1]
    middle = theta + 0.5 * omega * dt
    moved = [x + v * dt * math.cos(middle), y + v * dt * math.sin(middle), theta + omega * dt]
    return np.array([*moved, *state[3:]]), omega


@pytest.mark.parametrize("seed", range(2))
def test_it_is_the_joint_filter_with_the_errors_of_the_twist_as_states(seed):
    """There the errors of the twist are states for the time of the step, and the gyro is an ordinary measurement."""
    rng = np.random.default_rng(seed)
    dt, measured, variance = 0.1, rng.uniform(-1.0, 1.0, 2), rng.uniform(1e-5, 1e-2)
    M = covariance(rng, 2, 0.02, 0.2)
    found = gated_filter(
        "ekf_calibrating", rng.normal(size=3), use_gyro=True, wheel_radius_walk=0.0, gyro_bias_walk=0.0
    )
    # Small errors, so that both are linear; the states are correlated, as they are after a while.
    x, P = np.array([*found.memory.belief.x[:3], *rng.normal(0.0, 1e-5, 4)]), 1e-6 * covariance(rng, 7)
    found.memory = found.memory._replace(belief=found.memory.belief._replace(x=x, P=P))
    rate = moved(x, measured, (0.0, 0.0), dt)[1] + x[6] + 1e-4
    motion = build_motion(*measured, dt, M[0, 0], M[0, 1], M[1, 1])._replace(rate=TurnRate(rate, variance))
    assert found.take_rate(GyroRate(0, motion.rate, motion.twist, motion.covariance, SEPARATION), dt) is None
    found.predict(motion)

    joint, whole = np.array([*x, 0.0, 0.0]), np.zeros((9, 9))
    whole[:7, :7], whole[7:, 7:] = P, M
    H = jacobian(lambda s: np.array([moved(s[:7], measured, s[7:], dt)[1] + s[6]]), joint)
    S = (H @ whole @ H.T).item() + variance
    K = whole @ H.T / S
    joint = joint + K[:, 0] * (rate - moved(x, measured, (0.0, 0.0), dt)[1] - x[6])
    whole = whole - K @ K.T * S
    F = jacobian(lambda s: moved(s[:7], measured, s[7:], dt)[0], joint)
    np.testing.assert_allclose(found.memory.belief.x, moved(joint[:7], measured, joint[7:], dt)[0], atol=1e-8)
    np.testing.assert_allclose(found.memory.belief.P, F @ whole @ F.T, atol=2e-8 * np.abs(P).max() + 1e-10)


def started(use_gyro=True, **options):
    found = Localization(LocalizationConfig(filter=FilterConfig(use_gyro=use_gyro)), SEPARATION, **options)
    found.initialise(Pose(0.0, 0.0, 0.0), R_FIX, 0)
    return found


SHARE = 0.05 / math.sqrt(3.0)
"""Deviation of a wheel's speed over the speed."""


class Straight:
    """A robot that drives straight on with 0.6 m/s for so many steps at 50 Hz; the wheels' noise grows with speed."""

    def __init__(self, seed, left=0.0, right=0.0):
        rng = np.random.default_rng(seed)
        self.found = gated_filter("ekf_calibrating", use_gyro=True)
        self._numbers = ((rng.normal(0.0, SHARE, 2), rng.normal(0.0, SIGMA)) for _ in count())
        self.slip(left, right)

    def slip(self, left, right):
        """Let each wheel lose a share of its motion."""
        self._lost = np.array([left, right])

    def drive(self, steps):
        """Return the deviations of the difference of the radius errors after the steps."""
        found = []
        for _, (noise, error) in zip(range(steps), self._numbers, strict=False):
            measured = 0.6 * (1.0 + noise)
            real = 0.6 * (1.0 - self._lost)
            variances = (SHARE * measured) ** 2
            twist = Twist(measured.mean(), (measured[1] - measured[0]) / SEPARATION)
            covariance = TwistCovariance(
                variances.sum() / 4.0,
                (variances[1] - variances[0]) / (2.0 * SEPARATION),
                variances.sum() / SEPARATION**2,
            )
            rate = TurnRate((real[1] - real[0]) / SEPARATION + BIAS + error, SIGMA**2)
            self.found.take_rate(GyroRate(0, rate, twist, covariance, SEPARATION), 0.02)
            self.found.predict(build_motion(*twist, 0.02, *covariance)._replace(rate=rate))
            P = self.found.wheels().P
            found.append(math.sqrt(P[0, 0] - 2.0 * P[0, 1] + P[1, 1]))
        return np.array(found)

    def radii(self):
        return self.found.wheels().errors[:2]


@pytest.mark.parametrize("seed", range(3))
def test_noise_of_the_wheels_makes_no_radius_smaller(seed):
    """The noise is in the wheels' turn rate and in what that turn rate is multiplied by."""
    robot = Straight(seed)
    spread = robot.drive(1500)
    assert np.abs(robot.radii()).max() < 0.004  # of a prior of 0.01; both fall to -0.01 and below if it does
    assert np.diff(spread).max() < 1e-4  # never less certain where nothing slips


@pytest.mark.parametrize(("left", "right"), [(0.0, 0.05), (0.05, 0.0), (0.0, 0.12)])
def test_a_slip_that_begins_and_ends_is_followed_within_three_seconds(left, right):
    robot = Straight(1)
    robot.drive(500)
    for lost in ((left, right), (0.0, 0.0)):
        robot.slip(*lost)
        robot.drive(150)
        e_left, e_right = robot.radii()
        assert e_right - e_left == pytest.approx(lost[0] - lost[1], abs=0.02)
        robot.drive(250)
    assert robot.found.gyro_bias().errors.item() == pytest.approx(BIAS, abs=0.015)


@pytest.mark.parametrize(("rims", "variance"), [(2.0, 0.5 * (3.0 * 0.1 / 2.0) ** 2), (1.0, 0.2**2), (0.0, 0.0)])
def test_each_radius_has_half_of_the_variance_that_explains_a_lasting_difference(rims, variance):
    """Thrice the deviation, since the difference is found while it grows; not of wheels that stand."""
    found, mean = 0.0, 0.0
    while not found and mean < 0.99:
        mean, found = add_innovation(mean, 0.1, 0.01, 0.02, (0.0, 0.0))
    found = add_innovation(mean, 0.1, 0.01, 0.02, (-rims, rims)).variance
    assert found == pytest.approx(variance, rel=0.03)


def test_the_twist_has_the_turn_rate_of_the_gyro():
    found = started()
    wheels = OdometryStep(STEP, Twist(0.5, 0.1), TwistCovariance(1e-4, 0.0, 0.09))
    found.on_gyro(GyroSample(STEP, 0.4, 0.01))
    estimate = found.on_odometry(wheels)
    twist, covariance = found.twist_of(estimate, wheels)
    bias = estimate.average.x[-1]
    corrected = found.filter.corrected_twist(wheels.twist, estimate.average.x)
    assert twist.v == pytest.approx(corrected.v)
    assert twist.omega == pytest.approx((0.01 * corrected.omega + 0.09 * (0.4 - bias)) / 0.1)
    assert covariance.var_omega == pytest.approx(0.09 * 0.01 / 0.1)
    without = OdometryStep(2 * STEP, wheels.twist, wheels.covariance)
    estimate = found.on_odometry(without)
    corrected = found.filter.corrected_twist(wheels.twist, estimate.average.x)
    assert found.twist_of(estimate, without) == (corrected, wheels.covariance)


def refused(found, sample, message):
    with pytest.raises(BadMessageError) as caught:
        found.on_gyro(sample)
    assert str(caught.value).startswith(message)


def test_what_is_refused_changes_nothing():
    found = started()
    for number in range(1, 31):
        found.on_gyro(GyroSample(number * STEP, 0.1, 1e-4))
        found.on_odometry(OdometryStep(number * STEP, Twist(0.5, 0.1), TwistCovariance(1e-4, 0.0, 0.09)))
    before = found.filter.memory
    refused(found, GyroSample(30 * STEP, 0.1, 1e-4), "duplicate")
    refused(found, GyroSample(0, 0.1, 1e-4), "too old")
    refused(found, GyroSample(31 * STEP, math.nan, 1e-4), "measurement not finite")
    refused(found, GyroSample(31 * STEP, 0.1, math.inf), "measurement not finite")
    for number in range(10_000):
        found.on_gyro(GyroSample(31 * STEP + number, 0.1, 1e-4))
    refused(found, GyroSample(32 * STEP, 0.1, 1e-4), "no odometry for it")
    assert found.filter.memory is before
    refused(started(use_gyro=False), GyroSample(STEP, 0.1, 1e-4), "not used")
    found.reset()
    refused(found, GyroSample(STEP, 0.1, 1e-4), "no odometry yet")


def test_a_gap_in_the_odometry_is_turned_through_by_the_gyro():
    found, certain = started(max_extrapolation=0.1), TwistCovariance(1e-6, 0.0, 1e-6)
    found.on_odometry(OdometryStep(STEP, Twist(0.0, 1.0), certain))
    for number in range(2, 12):
        found.on_gyro(GyroSample(number * STEP, 1.0, SIGMA**2))
    estimate = found.on_odometry(OdometryStep(11 * STEP, Twist(0.0, 1.0), certain))
    assert estimate.pose.theta == pytest.approx(1.1, abs=0.02)
