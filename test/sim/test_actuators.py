"""Actuators against closed forms: dead time, ramps, lag, dead band, slip and wheel separation."""

import math

import numpy as np
import pytest
from noise_rows import noise_row
from scipy.integrate import quad

from diffbot_core.geometry import Pose
from diffbot_core.kinematics import Twist
from diffbot_sim.config import PlantConfig
from diffbot_sim.noise import FURTHER, half_normal
from diffbot_sim.plant import command_rows, delayed_command, new_plant, plant_step

QUIET = PlantConfig(drive_noise=0.0, encoder_noise=0.0)
SILENCE = noise_row()
ORIGIN = Pose(0.0, 0.0, 0.0)
R, L, T_S = 0.05, 0.6, 0.1


def driven(commands, **actuators):
    """Return the states after each command, from rest and without noise."""
    config = QUIET._replace(**actuators)
    state, found = new_plant(ORIGIN), []
    for command in commands:
        state = plant_step(state, command, SILENCE, config)
        found.append(state)
    return found


@pytest.mark.parametrize("delay", [0.02, 0.16, 0.999])
def test_the_delayed_command_is_the_mean_of_the_shifted_commands_over_each_step(delay):
    commands = [Twist(1.0 + step, 0.5 - step) for step in range(30)]
    record = np.zeros((command_rows(delay, T_S), 2))

    def staircase(time):
        step = math.floor(time / T_S)
        return commands[step].v if step >= 0 else 0.0

    for step, command in enumerate(commands):
        found = delayed_command(record, step, command, delay, T_S)
        # In the middle of 1000 slices of the step.
        mean = np.mean([staircase((step + (part + 0.5) / 1000.0) * T_S - delay) for part in range(1000)])
        assert found.v == pytest.approx(mean, abs=1e-9)
        if staircase(step * T_S - delay - 1e-6) > 0.0:
            assert found.omega == pytest.approx(1.5 - found.v, abs=1e-12)


def test_each_axis_accelerates_along_its_own_ramp():
    commands = [Twist(0.7, 2.0)] * 25 + [Twist(-0.2, 2.0)] * 25
    found = driven(commands, acceleration_max=0.5, angular_acceleration_max=1.5)
    up = np.minimum(0.05 * np.arange(1, 26), 0.7)
    down = np.maximum(0.7 - 0.05 * np.arange(1, 26), -0.2)
    assert [one.twist.v for one in found] == pytest.approx([*up, *down], abs=1e-12)
    assert [one.twist.omega for one in found] == pytest.approx(np.minimum(0.15 * np.arange(1, 51), 2.0), abs=1e-12)


@pytest.mark.parametrize("tau", [1e-300, 0.15, 10.0])
def test_the_lag_is_the_step_response_of_a_first_order_system(tau):
    found = driven([Twist(0.6, 0.0)] * 20, drive_time_constant=tau)
    for step, state in enumerate(found):
        begin, end = step * T_S, (step + 1) * T_S
        mean = quad(lambda time: 1.0 - math.exp(-time / tau), begin, end, epsabs=1e-13)[0] / T_S if tau > 1e-9 else 1.0
        assert state.twist.v == pytest.approx(0.6 * mean, abs=1e-9)
        assert state.encoder == pytest.approx((12.0 * mean, 12.0 * mean), abs=1e-9)
        assert state.drives.lagged.left == pytest.approx(-12.0 * math.expm1(-end / tau), abs=1e-9)
    # The distance: v (t - tau (1 - exp(-t / tau))).
    assert found[-1].pose.x == pytest.approx(0.6 * (2.0 + tau * math.expm1(-2.0 / tau)), abs=1e-9)


def test_a_wheel_stands_still_within_the_dead_band():
    # Up from 0 to 2 rad/s in steps of 0.1, and down again to -2 rad/s.
    speeds = np.concatenate([np.arange(0, 21), np.arange(20, -21, -1)]) / 10.0 + 0.01
    found = driven([Twist(R * speed, 0.0) for speed in speeds], dead_band=0.6)
    turning = [one.drives.turning.left for one in found]
    expected = [speed if abs(speed) >= 0.6 else 0.0 for speed in speeds]
    assert turning == pytest.approx(expected, abs=1e-12)
    assert [one.encoder.right for one in found] == pytest.approx(expected, abs=1e-12)
    assert [one.twist.v for one in found] == pytest.approx(R * np.array(expected), abs=1e-12)
    assert turning[-1] == pytest.approx(-1.99)


def test_a_command_passes_the_stages_in_order():
    # The acceleration limit allows 0.05 m/s = 1 rad/s in the first step. The lag reaches half of it.
    tau = 0.1 / math.log(2.0)
    mean = 1.0 - tau * 0.5 / 0.1
    for dead_band, expected in ((mean - 1e-6, mean), (mean + 1e-6, 0.0)):
        state = driven([Twist(1.0, 0.0)], acceleration_max=0.5, drive_time_constant=tau, dead_band=dead_band)[0]
        assert state.drives.lagged.left == pytest.approx(0.5)
        assert state.drives.turning.left == pytest.approx(expected)


def test_an_error_of_the_wheel_separation_changes_the_radius_of_a_turn():
    error = -0.1
    config = QUIET._replace(separation_error=error)
    state, far = new_plant(ORIGIN), 0.0
    # A full circle of the true robot: requested radius 0.4 m, true radius 0.4 (1 + error).
    turn = 2.0 * math.pi * (1.0 + error)
    for _ in range(100):
        state = plant_step(state, Twist(0.4 * turn / 10.0, turn / 10.0), SILENCE, config)
        far = max(far, math.hypot(state.pose.x, state.pose.y))
    assert far == pytest.approx(0.8 * (1.0 + error), rel=1e-12)
    assert math.hypot(state.pose.x, state.pose.y) == pytest.approx(0.0, abs=1e-12)
    # The odometry turns by a different angle than the robot.
    assert state.odometry.theta == pytest.approx(math.remainder(turn, 2.0 * math.pi), abs=1e-9)


def test_slip_noise_is_half_normal_and_changes_the_motion_but_not_the_encoders():
    rng = np.random.default_rng(5)
    shares = np.array([half_normal(*rng.random(2), 0.05) for _ in range(3000)])
    # Of |N(0, s)|: the mean is s sqrt(2 / pi), the variance s^2 (1 - 2 / pi).
    np.testing.assert_allclose(shares.mean(axis=0), 0.05 * math.sqrt(2.0 / math.pi), rtol=0.06)
    np.testing.assert_allclose(shares.var(axis=0), 0.05**2 * (1.0 - 2.0 / math.pi), rtol=0.12)
    assert abs(np.corrcoef(shares.T)[0, 1]) < 4.0 / math.sqrt(3000)
    config, state = QUIET._replace(slip_noise=0.05), new_plant(ORIGIN)
    for _ in range(50):
        noise = noise_row(0.0, 0.0, *rng.uniform(-1.0, 1.0, 2), purpose=FURTHER)
        state = plant_step(state, Twist(1.0, 0.0), noise, config)
        assert state.encoder == (20.0, 20.0)
        left, right = (1.0 - lost for lost in half_normal(*noise[FURTHER, 2:], 0.05))
        assert state.twist == pytest.approx((0.5 * (left + right), (right - left) / L))
    state = plant_step(new_plant(ORIGIN), Twist(1.0, 0.0), noise, QUIET._replace(slip_noise=1e3))
    assert state.twist == (0.0, 0.0), "a wheel cannot lose more than its whole motion"
