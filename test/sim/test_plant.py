"""True motion and encoders against the paper's equations, circles and calculations by hand."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from noise_rows import noise_row

from diffbot_core.geometry import Pose, into_frame
from diffbot_core.kinematics import Twist, WheelGeometry
from diffbot_sim.config import PlantConfig
from diffbot_sim.plant import PlantState, integrate, plant_step

CHECK = settings(max_examples=150)
QUIET = PlantConfig(drive_noise=0.0, encoder_noise=0.0)
SILENCE = noise_row()
START = PlantState(Pose(1.0, 2.0, 0.5))
POSES = st.builds(Pose, st.floats(-50.0, 50.0), st.floats(-50.0, 50.0), st.floats(-3.1, 3.1))
TWISTS = st.builds(Twist, st.floats(-2.0, 2.0), st.floats(-3.0, 3.0))
NOISES = st.tuples(*[st.floats(-1.0, 1.0)] * 4)
R, L = 0.05, 0.6


def assert_pose(pose, expected, tolerance=1e-9):
    assert pose[:2] == pytest.approx(expected[:2], abs=tolerance)
    turn = math.remainder(pose.theta - expected[2], 2.0 * math.pi)
    assert turn == pytest.approx(0.0, abs=tolerance)
    assert -math.pi < pose.theta <= math.pi


@CHECK
@given(POSES, TWISTS, st.floats(0.001, 2.0))
def test_euler_step_is_equation_3(pose, twist, t_s):
    expected = (
        pose.x + t_s * twist.v * math.cos(pose.theta),
        pose.y + t_s * twist.v * math.sin(pose.theta),
        pose.theta + t_s * twist.omega,
    )
    assert_pose(integrate(pose, twist, t_s, False), expected, 1e-12)


@CHECK
@given(POSES, st.floats(-2.0, 2.0), st.floats(0.01, 3.0), st.sampled_from((1.0, -1.0)), st.floats(0.01, 3.0))
def test_an_arc_is_a_circle_around_its_centre(pose, v, speed, side, t_s):
    # The centre is v / omega to the left. The robot turns around it by omega t.
    omega = side * speed
    centre = complex(pose.x, pose.y) + 1j * (v / omega) * complex(math.cos(pose.theta), math.sin(pose.theta))
    turned = complex(math.cos(omega * t_s), math.sin(omega * t_s))
    end = centre + (complex(pose.x, pose.y) - centre) * turned
    found = integrate(pose, Twist(v, omega), t_s, True)
    assert_pose(found, (end.real, end.imag, pose.theta + omega * t_s), 1e-8)


def test_a_straight_line_is_the_limit_of_an_arc():
    for omega in (0.0, 5e-324, 1e-300, 1e-12, -1e-9):
        found = integrate(Pose(1.0, 2.0, 0.5), Twist(2.0, omega), 1.5, True)
        assert_pose(found, (1.0 + 3.0 * math.cos(0.5), 2.0 + 3.0 * math.sin(0.5), 0.5), 1e-8)


@CHECK
@given(TWISTS, NOISES, st.floats(0.0, 0.5), st.floats(0.0, 0.5))
def test_drive_and_encoder_noise_equal_a_calculation_by_hand(command, noise, drive_noise, encoder_noise):
    radius, separation = 0.1, 1.0
    config = QUIET._replace(
        wheels=WheelGeometry(radius, separation), drive_noise=drive_noise, encoder_noise=encoder_noise
    )
    state = plant_step(START, command, noise_row(*noise), config)
    nominal = [(command.v + side * 0.5 * command.omega * separation) / radius for side in (-1.0, 1.0)]
    left, right = nominal
    left, right = left * (1.0 + drive_noise * noise[0]), right * (1.0 + drive_noise * noise[1])
    assert state.drives.lagged == pytest.approx(nominal, abs=1e-9)
    assert state.twist == pytest.approx((radius * (left + right) / 2.0, radius * (right - left) / separation), abs=1e-9)
    measured = left * (1.0 + encoder_noise * noise[2]), right * (1.0 + encoder_noise * noise[3])
    assert state.encoder == pytest.approx(measured, abs=1e-9)


@CHECK
@given(TWISTS, NOISES)
def test_the_papers_input_noise_is_added_and_measured_by_the_encoders(command, noise):
    config = QUIET._replace(eps_v_max=0.065, eps_omega_max=0.2167)
    state = plant_step(START, command, noise_row(*noise), config)
    v, omega = command.v + 0.065 * noise[0], command.omega + 0.2167 * noise[1]
    assert state.twist == pytest.approx((v, omega), abs=1e-12)
    assert state.encoder == pytest.approx(((v - 0.5 * omega * L) / R, (v + 0.5 * omega * L) / R), abs=1e-9)


def test_radius_errors_move_the_body_but_not_the_encoders():
    config = QUIET._replace(left_radius_error=0.02, right_radius_error=-0.01)
    state = plant_step(START, Twist(1.0, 0.0), SILENCE, config)
    # Wheels of 1.02 and 0.99 m/s: v = 1.005, omega = -0.03 / 0.6.
    assert state.twist == pytest.approx((1.005, -0.05))
    assert state.encoder == pytest.approx((20.0, 20.0))
    assert state.odometry == pytest.approx((0.1, 0.0, 0.0))


@pytest.mark.parametrize(
    ("t_s", "start", "duration", "expected"),
    [
        (0.1, 0.0, 0.3, range(3)),
        (0.25, 0.3, 0.5, range(2, 4)),
        # Whole steps, although these times have rounding errors.
        (0.1, 1.1, 3.2, range(11, 43)),
    ],
)
def test_a_wheel_slips_for_the_configured_time(t_s, start, duration, expected):
    config = QUIET._replace(sampling_time=t_s, slip_right=0.6, slip_start=start, slip_duration=duration)
    state = START
    for step in range(60):
        state = plant_step(state, Twist(1.0, 0.0), SILENCE, config)
        # The right wheel loses 60 %: (1 + 0.4) / 2 and (0.4 - 1) / 0.6.
        assert state.twist == pytest.approx((0.7, -1.0) if step in expected else (1.0, 0.0))
        assert state.encoder == pytest.approx((20.0, 20.0))


@pytest.mark.parametrize(("t_s", "time", "number"), [(0.1, 2.01, 21), (0.02, 0.14, 7)])
def test_a_kidnapped_robot_is_displaced_once_at_the_configured_time(t_s, time, number):
    config = QUIET._replace(sampling_time=t_s)
    kidnapped = config._replace(kidnap_time=time, kidnap_x=2.0, kidnap_yaw=-2.5)
    here = there = START
    for step in range(1, number + 30):
        before = here.pose, there.pose
        here, there = (
            plant_step(state, Twist(0.8, 0.5), SILENCE, one) for state, one in ((here, config), (there, kidnapped))
        )
        # Wheels and odometry do not change.
        assert there._replace(pose=here.pose) == here
        if step < number:
            assert there.pose == here.pose
        if step == number:
            assert_pose(there.pose, (here.pose.x + 2.0, here.pose.y, here.pose.theta - 2.5))
        # Afterwards both make the same motions.
        if step > number:
            moves = [into_frame(now, last) for now, last in zip((here.pose, there.pose), before, strict=True)]
            assert moves[1] == pytest.approx(moves[0], abs=1e-12)


def test_the_speed_limit_keeps_the_curvature():
    config = QUIET._replace(wheel_speed_max=11.5)
    # 1 m/s and 0.5 rad/s need 17 and 23 rad/s. The limit halves both.
    state = plant_step(START, Twist(1.0, 0.5), SILENCE, config)
    assert state.drives.turning == pytest.approx((8.5, 11.5))
    assert state.twist == pytest.approx((0.5, 0.25))
    assert plant_step(START, Twist(-1.0, -0.5), SILENCE, config).twist == pytest.approx((-0.5, -0.25))
    assert plant_step(START, Twist(0.4, 0.5), SILENCE, config).twist == pytest.approx((0.4, 0.5))


def test_odometry_and_wheel_angles_are_the_integral_of_the_encoders():
    rng = np.random.default_rng(4)
    config = PlantConfig(slip_right=0.5, slip_duration=2.0, right_radius_error=0.1, eps_v_max=0.1)
    state = START
    x = y = theta = 0.0
    angles = np.zeros(2)
    for _ in range(60):
        state = plant_step(state, Twist(*rng.uniform(-1.0, 1.0, 2)), noise_row(*rng.uniform(-1, 1, 4)), config)
        left, right = state.encoder
        angles += 0.1 * np.array([left, right])
        v, omega = R * (left + right) / 2.0, R * (right - left) / L
        end = theta + 0.1 * omega
        x += v / omega * (math.sin(end) - math.sin(theta))
        y -= v / omega * (math.cos(end) - math.cos(theta))
        theta = end
    assert state.angles == pytest.approx(angles, abs=1e-9)
    assert_pose(state.odometry, (x, y, theta), 1e-9)
    assert state.step == 60
    # Slip and radius errors are not measured.
    assert math.hypot(state.odometry.x - state.pose.x, state.odometry.y - state.pose.y) > 0.1
