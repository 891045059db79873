"""The error of the wheel separation as a state: v and omega have scales of their own."""

import math

import numpy as np
import pytest

from diffbot_control.filter.belief import ErrorEstimate
from diffbot_control.filter.ekf import PoseEkf
from diffbot_control.filter.gated_filter import GatedFilter
from diffbot_control.filter.measurements import PoseFix
from diffbot_control.filter.models import Motion
from diffbot_control.filter.options import FilterConfig, options_of
from diffbot_core.errors import InvalidValueError
from diffbot_core.geometry import Pose
from diffbot_core.kinematics import Twist, TwistCovariance
from diffbot_sim.compiled.scalar_filter import check_supported

L = 0.6
WIDE = FilterConfig(wheel_radius_sigma=0.1, wheel_separation_sigma=0.1)


def moved(x, v, omega, dt):
    """Rims of wheels whose radii are (1 + e) times and whose distance is (1 + s) times the configured one."""
    px, py, theta, left, right, separation = x
    rim_left = (v - 0.5 * omega * L) * (1.0 + left)
    rim_right = (v + 0.5 * omega * L) * (1.0 + right)
    speed, turn = 0.5 * (rim_left + rim_right), (rim_right - rim_left) / (L * (1.0 + separation))
    middle = theta + 0.5 * turn * dt
    pose = [px + speed * dt * math.cos(middle), py + speed * dt * math.sin(middle), theta + turn * dt]
    return np.array([*pose, left, right, separation])


@pytest.mark.parametrize("seed", range(2))
def test_mean_and_jacobian_are_those_of_the_wheels(seed):
    rng = np.random.default_rng(seed)
    x = np.array([*rng.uniform(-1.0, 1.0, 3), *rng.uniform(-0.15, 0.15, 3)])
    v, omega, dt = rng.uniform(-1.0, 1.0), rng.uniform(-2.0, 2.0), 0.2
    ekf = PoseEkf(3)
    ekf.wheel_separation, ekf.random_walk = L, 1e-3
    ekf.set_state(x, np.eye(6))
    ekf.predict(Motion(Twist(v, omega), dt, TwistCovariance(0.0, 0.0, 0.0)))
    np.testing.assert_allclose(ekf.x, moved(x, v, omega, dt), rtol=1e-12, atol=1e-12)
    columns = [(moved(x + h, v, omega, dt) - moved(x - h, v, omega, dt)) / 2e-6 for h in 1e-6 * np.eye(6)]
    F = np.column_stack(columns)
    expected = F @ F.T + np.diag([0.0, 0.0, 0.0, *[1e-3 * dt] * 3])
    np.testing.assert_allclose(ekf.P, expected, atol=1e-7)


def test_errors_of_ten_percent_are_found():
    """Radii 8 % and 6 % too small, wheels 10 % further apart: each is found within 3 of its deviations and 2 %."""
    true, dt, rng = np.array([-0.08, -0.06, 0.10]), 0.1, np.random.default_rng(4)
    found, x = GatedFilter(options_of(WIDE), L), np.array([0.0, 0.0, 0.0, *true])
    found.reset_to(Pose(0.0, 0.0, 0.0), 0.01 * np.eye(3))
    R = np.diag([0.05, 0.05, 0.03]) ** 2
    for step in range(3000):
        v, omega = 0.5 + 0.3 * math.sin(step / 40.0), 0.8 * math.sin(step / 70.0)
        found.predict(Motion(Twist(v, omega), dt, TwistCovariance(1e-4, 0.0, 1e-4)))
        x = moved(x, v + rng.normal(0.0, 0.01), omega + rng.normal(0.0, 0.01), dt)
        if step % 5 == 0:
            z = x[:3] + rng.normal(0.0, np.sqrt(np.diag(R)))
            found.take(PoseFix(step, Pose(z[0], z[1], math.remainder(z[2], 2.0 * math.pi)), R))
    wheels = found.wheels()
    assert np.abs(wheels.errors - true).max() < 0.02
    assert (np.abs(wheels.errors - true) < 3.0 * np.sqrt(np.diag(wheels.P))).all()


@pytest.mark.parametrize("index", [0, 1, 2])
def test_an_error_beyond_its_bound_resets_all_three(index):
    found = GatedFilter(options_of(WIDE), L)
    found.reset_to(Pose(0.0, 0.0, 0.0), 0.01 * np.eye(3))
    for size, kept in ((0.49, True), (0.51, False)):
        errors = np.zeros(3)
        errors[index] = size
        found.set_wheels(ErrorEstimate(errors, 1e-8 * np.eye(3)))
        found.take(PoseFix(0, Pose(0.0, 0.0, 0.0), np.eye(3)))
        assert (found.wheels().errors == 0.0).all() != kept
    np.testing.assert_allclose(found.wheels().P, 0.01 * np.eye(3))


@pytest.mark.parametrize(
    ("config", "name"),
    [
        (WIDE, "wheel_separation_sigma"),
        (FilterConfig(landmark_gate="weigh"), "landmark_gate"),
        (FilterConfig(fix_correlation_time=1.0), "correlation"),
        (FilterConfig(landmark_range_offset=0.1), "landmark_range_offset"),
        (FilterConfig(landmark_bearing_offset_sigma=0.1), "landmark_range_offset"),
    ],
)
def test_the_compiled_filter_refuses_what_it_does_not_have(config, name):
    with pytest.raises(InvalidValueError, match=name):
        check_supported(options_of(config))
    check_supported(options_of(FilterConfig()))
