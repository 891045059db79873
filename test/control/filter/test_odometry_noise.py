"""Noise of the odometry: what it means per second, metre and radian, at any rate of the messages."""

import math

import numpy as np
import pytest

from diffbot_control.filter.localization import Localization
from diffbot_control.filter.localization_config import LocalizationConfig
from diffbot_control.filter.measurements import OdometryStep, PoseFix
from diffbot_control.filter.odometry_noise import DENSITY, MESSAGE, MOTION, OdometryConfig, motion_density
from diffbot_control.filter.options import EKF, FNN, FilterConfig
from diffbot_core.geometry import Pose
from diffbot_core.kinematics import Twist, TwistCovariance

UNKNOWN = TwistCovariance(0.0, 0.0, 0.0)
NOISE = OdometryConfig(
    MOTION, alpha1=0.02, alpha2=0.004, alpha3=0.03, alpha4=0.005, density_xy=1e-3, density_theta=2e-4
)


def covariance_after(twist, rate, seconds, odometry, covariance=UNKNOWN, variant=EKF, late=None):
    """Covariance (3, 3) of a pose known at first, after driving with a constant twist."""
    localization = Localization(LocalizationConfig(1.0, FilterConfig(filter=variant), odometry))
    localization.initialise(Pose(0.0, 0.0, 0.3), np.diag([1e-12, 1e-12, 1e-12]), 0)
    for number in range(1, round(seconds * rate) + 1):
        localization.on_odometry(OdometryStep(round(number * 1e9 / rate), twist, covariance))
        if late is not None and number == 2:
            localization.on_measurement(late)
    return localization.estimate().P


def densities(twist):
    """Variances per second along, across and of the heading, written anew from their meaning."""
    v, omega = abs(twist.v), abs(twist.omega)
    return 0.03 * v + 0.005 * omega + 1e-3, 1e-3, 0.02 * omega + 0.004 * v + 2e-4


@pytest.mark.parametrize("twist", [Twist(0.5, 0.4), Twist(0.0, -1.2)])
def test_the_noise_of_a_motion_is_that_of_many_random_walks(twist):
    """Robots whose velocities have white noise, in steps of 10 ms."""
    along, across, heading = densities(twist)
    rng, count, dt = np.random.default_rng(5), 20_000, 1e-2
    x, y, theta = np.zeros(count), np.zeros(count), np.full(count, 0.3)
    for _ in range(200):
        forward, sideways, turn = (
            rng.normal(0.0, math.sqrt(density * dt), count) for density in (along, across, heading)
        )
        middle = theta + 0.5 * (twist.omega * dt + turn)
        x += (twist.v * dt + forward) * np.cos(middle) - sideways * np.sin(middle)
        y += (twist.v * dt + forward) * np.sin(middle) + sideways * np.cos(middle)
        theta += twist.omega * dt + turn
    expected = np.cov(np.array([x, y, theta]))
    found = covariance_after(twist, 10.0, 2.0, NOISE)
    deviations = np.sqrt(np.diag(expected))
    np.testing.assert_allclose(
        found / np.outer(deviations, deviations), expected / np.outer(deviations, deviations), atol=0.04
    )


@pytest.mark.parametrize(("kind", "covariance"), [(MOTION, UNKNOWN), (DENSITY, TwistCovariance(0.02, 0.001, 0.03))])
@pytest.mark.parametrize("variant", [EKF, FNN])
def test_the_rate_of_the_messages_does_not_change_it(kind, covariance, variant):
    twist, noise = Twist(0.6, 0.5), NOISE._replace(odometry_noise=kind)
    reference = covariance_after(twist, 100.0, 3.0, noise, covariance, variant)
    for rate in (5.0, 20.0):
        found = covariance_after(twist, rate, 3.0, noise, covariance, variant)
        np.testing.assert_allclose(found, reference, rtol=0.01, atol=1e-4)


def test_a_density_is_the_variance_per_second():
    noise = OdometryConfig(DENSITY)
    P = covariance_after(Twist(0.8, 0.0), 20.0, 4.0, noise, TwistCovariance(0.02, 0.0, 0.03))
    turned = np.array([[math.cos(0.3), math.sin(0.3)], [-math.sin(0.3), math.cos(0.3)]])
    along, across = np.diag(turned @ P[:2, :2] @ turned.T)
    assert along == pytest.approx(0.02 * 4.0, rel=1e-9)
    assert across == pytest.approx(0.8**2 * 0.03 * 4.0**3 / 3.0, rel=1e-9)
    assert P[2, 2] == pytest.approx(0.03 * 4.0, rel=1e-9)


def test_the_noise_of_the_motion_takes_the_place_of_a_covariance_that_is_unknown_or_not_asked_for():
    twist = Twist(0.4, 0.3)
    expected = covariance_after(twist, 10.0, 2.0, NOISE)
    for kind in (MESSAGE, DENSITY):
        found = covariance_after(twist, 10.0, 2.0, NOISE._replace(odometry_noise=kind))
        assert np.array_equal(found, expected)
    assert np.array_equal(covariance_after(twist, 10.0, 2.0, NOISE, TwistCovariance(1e-9, 0.0, 1e-9)), expected)


def test_a_measurement_within_an_odometry_interval_parts_the_noise():
    """A fix that says nothing leaves the same covariance, wherever it cuts the interval."""
    twist, useless = Twist(0.6, 0.5), PoseFix(137_000_000, Pose(0.0, 0.0, 0.3), 1e7 * np.eye(3))
    expected = covariance_after(twist, 10.0, 1.0, NOISE)
    found = covariance_after(twist, 10.0, 1.0, NOISE, late=useless)
    np.testing.assert_allclose(found, expected, rtol=1e-3, atol=1e-7)


def test_each_alpha_has_its_own_motion():
    straight, spot, rest = Twist(-2.0, 0.0), Twist(0.0, -3.0), Twist(0.0, 0.0)
    for name, twist, along, heading in (
        ("alpha1", spot, 0.0, 3.0),
        ("alpha2", straight, 0.0, 2.0),
        ("alpha3", straight, 2.0, 0.0),
        ("alpha4", spot, 3.0, 0.0),
        ("density_xy", rest, 1.0, 0.0),
        ("density_theta", rest, 0.0, 1.0),
    ):
        zero = OdometryConfig(MOTION, alpha1=0.0, alpha2=0.0, alpha3=0.0, alpha4=0.0, density_xy=0.0, density_theta=0.0)
        density = motion_density(twist, zero._replace(**{name: 0.7}))
        assert density.twist == pytest.approx((0.7 * along, 0.0, 0.7 * heading))
        assert density.lateral == (0.7 if name == "density_xy" else 0.0)
