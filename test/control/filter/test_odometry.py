"""Odometry: its noise at any rate of the messages, and its dead time."""

import math

import numpy as np
import pytest

from diffbot_control.filter.localization import Localization
from diffbot_control.filter.localization_config import LocalizationConfig
from diffbot_control.filter.measurements import PoseFix
from diffbot_control.filter.odometry import OdometryStep
from diffbot_control.filter.odometry_noise import DENSITY, MESSAGE, MOTION, OdometryConfig
from diffbot_control.filter.options import EKF, FNN, FilterConfig
from diffbot_core.geometry import Pose
from diffbot_core.kinematics import Twist, TwistCovariance

UNKNOWN = TwistCovariance(0.0, 0.0, 0.0)
NOISE = OdometryConfig(
    MOTION, alpha1=0.02, alpha2=0.004, alpha3=0.03, alpha4=0.005, density_xy=1e-3, density_theta=2e-4
)


def covariance_after(twist, rate, seconds, odometry, covariance=UNKNOWN, variant=EKF):
    """Covariance (3, 3) of a pose known at first, after driving with a constant twist."""
    localization = Localization(LocalizationConfig(1.0, FilterConfig(filter=variant), odometry))
    localization.initialise(Pose(0.0, 0.0, 0.3), np.diag([1e-12, 1e-12, 1e-12]), 0)
    for number in range(1, round(seconds * rate) + 1):
        localization.on_odometry(OdometryStep(round(number * 1e9 / rate), twist, covariance))
    return localization.estimate().P


@pytest.mark.parametrize(("kind", "covariance"), [(MOTION, UNKNOWN), (DENSITY, TwistCovariance(0.02, 0.001, 0.03))])
@pytest.mark.parametrize("variant", [EKF, FNN])
def test_the_rate_of_the_messages_does_not_change_it(kind, covariance, variant):
    twist, noise = Twist(0.6, 0.5), NOISE._replace(odometry_noise=kind)
    reference = covariance_after(twist, 100.0, 3.0, noise, covariance, variant)
    for rate in (5.0, 20.0):
        found = covariance_after(twist, rate, 3.0, noise, covariance, variant)
        np.testing.assert_allclose(found, reference, rtol=0.01, atol=1e-4)


@pytest.mark.parametrize(
    ("v", "odometry", "densities"),
    [
        (0.8, OdometryConfig(DENSITY), (0.02, 0.0, 0.03)),
        # From the meaning of NOISE: 0.03 |v| + 1e-3 along, 1e-3 across, 0.004 |v| + 2e-4 of the heading.
        (-0.5, NOISE, (0.016, 1e-3, 2.2e-3)),
    ],
)
def test_a_density_is_the_variance_per_second(v, odometry, densities):
    P = covariance_after(Twist(v, 0.0), 20.0, 4.0, odometry, TwistCovariance(0.02, 0.0, 0.03))
    turned = np.array([[math.cos(0.3), math.sin(0.3)], [-math.sin(0.3), math.cos(0.3)]])
    along, across, heading = (4.0 * density for density in densities)
    found = *np.diag(turned @ P[:2, :2] @ turned.T), P[2, 2]
    assert found == pytest.approx((along, across + v**2 * heading * 4.0**2 / 3.0, heading), rel=1e-9)


MS = 10**6


def twist_at(time):
    """The commanded twist of the 100 ms that end at ``time`` [ms]."""
    return Twist(0.4 + 0.2 * math.sin(time / 700.0), 0.8 * math.cos(time / 400.0))


def drive(delay, times, kind=MESSAGE):
    odometry = OdometryConfig(kind, odometry_delay=delay)
    found = Localization(LocalizationConfig(5.0, FilterConfig(filter=EKF, gate_probability=1.0), odometry))
    found.initialise(Pose(0.0, 0.0, 0.0), 1e-6 * np.eye(3), times[0] * MS)
    noise = TwistCovariance(0.01, 0.0, 0.02)
    return [found.on_odometry(OdometryStep(time * MS, twist_at(time), noise)) for time in times]


def dead_reckoning(delay, times):
    """Robot that at each millisecond has the twist of ``delay`` [ms] before; at first that of the first message."""
    x, y, theta, poses, now = 0.0, 0.0, 0.0, [], times[0]
    for time in times:
        while now < time:
            now += 1
            number = next((one for one in times[1:] if one + delay >= now), times[-1])
            v, omega = twist_at(number)
            x += v * 1e-3 * math.cos(theta + 0.5e-3 * omega)
            y += v * 1e-3 * math.sin(theta + 0.5e-3 * omega)
            theta += 1e-3 * omega
        poses.append((x, y, theta))
    return np.array(poses)


@pytest.mark.parametrize(("delay", "kind"), [(0, MESSAGE), (30, MOTION), (250, MESSAGE)])
def test_the_twist_acts_later_by_the_delay(delay, kind):
    times = [0, 100, 200, 310, 400, 480, 600, *range(700, 3000, 100)]
    rows = drive(delay * 1e-3, times, kind)
    assert [row.stamp for row in rows] == [time * MS for time in times]
    expected = dead_reckoning(delay, times)
    found = np.array([row.pose for row in rows])
    np.testing.assert_allclose(found[:, :2], expected[:, :2], atol=2e-3)
    np.testing.assert_allclose(np.unwrap(found[:, 2]), expected[:, 2], atol=1e-9)


def test_the_noise_of_a_message_is_parted_among_its_pieces():
    """With errors independent from message to message: var_theta is the sum of var_omega dt^2 over the messages."""
    times = list(range(0, 3000, 100))
    rows = drive(0.25, times)
    # 0.25 s are covered by the first message, which is only 0.1 s long; then whole messages and the half of one.
    whole = 0.02 * 0.1**2
    assert rows[-1].P[2, 2] - 1e-6 == pytest.approx(whole * 29.0, rel=1e-9)


def after_a_gap(seconds, fixes=()):
    """A robot that drove with (0.5, 0.2) until 1 s; its odometry comes again ``seconds`` later with (0.4, 0.1)."""
    config = LocalizationConfig(60.0, FilterConfig(filter=EKF), OdometryConfig(MESSAGE))
    made = Localization(config, max_extrapolation=1.0)
    made.initialise(Pose(0.0, 0.0, 0.0), np.diag([1e-4, 1e-4, 1e-4]), 0)
    small = TwistCovariance(1e-8, 0.0, 1e-8)
    made.on_odometry(OdometryStep(10**9, Twist(0.5, 0.2), small))
    before = made.estimate()
    for one in fixes:
        made.on_measurement(one)
    return before, made.on_odometry(OdometryStep(round((1.0 + seconds) * 1e9), Twist(0.4, 0.1), small))


def test_a_dropout_of_the_odometry_moves_the_estimate_for_the_timeout_only_and_widens_it():
    before, after = after_a_gap(61.0)
    step = after_a_gap(1.0)[1]
    assert after.pose == pytest.approx(step.pose, abs=1e-9), "one second of the twist, not 61"
    assert after.stamp == 62 * 10**9
    # It may have been anywhere that the faster twist leads to in 60 s: 30 m in any direction, any heading.
    x, y, theta = np.sqrt(np.diag(after.P))
    assert theta == pytest.approx(math.pi, rel=1e-3)
    assert min(x, y) >= 29.9
    assert np.sqrt(np.diag(before.P)).max() < 0.1


def test_a_short_gap_is_driven_through_and_a_fix_in_a_long_one_is_fused_at_its_time():
    assert after_a_gap(1.0)[1].pose.theta == pytest.approx(0.2 + 0.1, abs=1e-6)
    fix = PoseFix(31 * 10**9, Pose(7.0, 3.0, 0.2), np.diag([1e-4, 1e-4, 1e-4]))
    _, after = after_a_gap(61.0, [fix])
    # 30 s of the gap are left after the fix, then a second of the twist.
    assert math.hypot(after.pose.x - 7.0, after.pose.y - 3.0) == pytest.approx(0.4, abs=0.01)
    assert math.sqrt(after.P[2, 2]) == pytest.approx(math.pi / math.sqrt(2.0), rel=0.02)
