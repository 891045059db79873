"""The law with braking profiles: equations, bounds, gains, Lyapunov functions and direction of travel."""

import itertools
import math

import pytest
from driven import Robot
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from diffbot_control.law.limits import limit_global
from diffbot_control.law.steering import (
    BACKWARD,
    FORWARD,
    Approach,
    Gains,
    Navigation,
    approach_speed,
    choose_approach,
    drive_and_hold,
    drive_and_steer,
    gains_of,
    global_lyapunov,
    local_lyapunov,
    navigation_variables,
    uncertainty_ratio,
)
from diffbot_core.data_sheet import DataSheet, rim_speed
from diffbot_core.geometry import Pose
from diffbot_core.kinematics import WheelGeometry

CHECK = settings(max_examples=100)
INF = math.inf
UNLIMITED = DataSheet(INF, INF, INF, INF, INF)
GAINS = st.builds(
    Gains,
    brake=st.floats(0.05, 20.0),
    react=st.floats(0.05, 5.0),
    turn_brake=st.floats(0.1, 30.0),
    turn_react=st.floats(0.05, 5.0),
    hold_brake=st.floats(0.1, 30.0),
    hold_react=st.floats(0.05, 5.0),
)
SHEETS = st.builds(
    lambda v, omega, wheel, radius, separation: DataSheet(v, omega, wheel, wheels=WheelGeometry(radius, separation)),
    st.floats(0.02, 5.0) | st.just(INF),
    st.floats(0.02, 10.0) | st.just(INF),
    st.floats(0.1, 100.0) | st.just(INF),
    st.floats(0.02, 0.3),
    st.floats(0.1, 2.0),
)
ANGLES = st.floats(-math.pi, math.pi)
DISTANCES = st.floats(1e-3, 50.0)


def profile(error, brake, react):
    """Return the speed s with s^2 / (2 brake) + s react = |error|, by another formula than the law's."""
    return math.copysign(brake * (math.sqrt(react**2 + 2.0 * abs(error) / brake) - react), error)


@CHECK
@given(DISTANCES, ANGLES, ANGLES, GAINS)
def test_the_commands_are_those_of_the_equations(rho, alpha, beta, gains):
    assume(abs(alpha) > 1e-3)
    f, h = profile(rho, gains.brake, gains.react), 0.8 * min(1.0, rho / 0.3)
    v, omega = f * math.cos(alpha), profile(alpha, gains.turn_brake, gains.turn_react)
    omega += f / rho * math.sin(alpha) / alpha * math.cos(alpha) * (alpha + h * beta)
    navigation = Navigation(rho, alpha, beta)
    for direction in (FORWARD, BACKWARD):
        expected = pytest.approx((direction * v, omega), rel=1e-6, abs=1e-9)
        assert drive_and_steer(navigation, 0.0, direction, gains, UNLIMITED) == expected
    hold = -profile(beta, gains.hold_brake, gains.hold_react)
    assert drive_and_hold(navigation, beta, 0.0, gains, UNLIMITED) == pytest.approx((v, hold), rel=1e-6, abs=1e-9)


@CHECK
@given(st.floats(-3.0, 3.0), st.floats(-5.0, 5.0), st.floats(-8.0, 8.0), SHEETS)
def test_the_limits_keep_the_steering_and_as_much_speed_as_a_search_finds(phi, v, turn, sheet):
    rim, half = rim_speed(sheet), 0.5 * sheet.wheels.wheel_separation

    def allowed(s, slack=0.0):
        speed, omega = abs(s * v), abs(kept + s * turn)
        bounds = ((speed, sheet.v_max), (omega, sheet.omega_max), (speed + half * omega, rim))
        return all(value <= bound * (1.0 + slack) + slack for value, bound in bounds)

    kept = math.copysign(min(abs(phi), sheet.omega_max, rim / half), phi)
    command = limit_global(phi, v, turn, sheet)
    assume(abs(v) > 0.01)
    found = command.v / v
    assert command.omega == pytest.approx(kept + found * turn, abs=1e-9)
    assert allowed(found, 1e-9)
    largest = max(s / 500 for s in range(501) if s == 0 or allowed(s / 500))
    assert found >= largest - 1e-9
    assert found <= 1.0


@CHECK
@given(st.floats(-3.0, 3.0), st.floats(-3.0, 3.0), st.floats(-3.1, 3.1), st.booleans(), st.booleans())
def test_the_allowed_approach_with_the_least_turning_is_chosen(x, y, theta, backward, symmetric):
    assume(math.hypot(x, y) > 0.1)

    def turning(direction, opposite_heading):
        """Return the angle of the turn onto the line to the goal, plus the angle of the turn to the heading there."""
        line = math.atan2(-y, -x) + (math.pi if direction == BACKWARD else 0.0)
        goal = math.pi if opposite_heading else 0.0
        return sum(abs(math.remainder(angle, math.tau)) for angle in (line - theta, goal - line))

    directions, opposites = (FORWARD, BACKWARD)[: 1 + backward], (False, True)[: 1 + symmetric]
    turnings = {Approach(*one): turning(*one) for one in itertools.product(directions, opposites)}
    found = choose_approach(navigation_variables(Pose(x, y, theta)), backward, symmetric)
    assert turnings[found] == pytest.approx(min(turnings.values()), abs=1e-9)


def test_an_uncertain_position_is_approached_with_a_longer_reaction_time():
    gains = gains_of(DataSheet(), 0.1)._replace(brake=2.0, react=0.5)
    known = approach_speed(0.4, 1.0, gains, 10.0)
    # s^2 / (2 brake) + s react = 0.4 with 0.5 s: s^2 / 4 + s / 2 - 0.4 = 0.
    assert known == pytest.approx(-1.0 + math.sqrt(1.0 + 1.6))
    # Twice the required deviation, which is 0.05 m, or 0.3 of a wide tolerance: 0.5 s times 2^2 = 2 s.
    assert uncertainty_ratio(0.1, 0.05, 0.1) == uncertainty_ratio(0.18, 0.05, 0.3) == pytest.approx(2.0)
    assert approach_speed(0.4, 2.0, gains, 10.0) == pytest.approx(-4.0 + math.sqrt(16.0 + 1.6))
    assert approach_speed(100.0, 0.0, gains, 1.3) == 1.3


def test_the_gains_follow_the_data_sheet_and_the_period():
    slow = gains_of(DataSheet(a_max=0.5, omega_dot_max=1.5, command_latency=0.2, drive_time_constant=0.1), 0.2)
    assert (slow.brake, slow.turn_brake, slow.hold_brake) == pytest.approx((0.43, 0.975, 0.975))
    # Half a period and 0.2 s of unknown latency: 0.3 s.
    assert (slow.react, slow.turn_react, slow.hold_react) == pytest.approx((0.6, 0.54, 0.48))
    fast = gains_of(DataSheet(), 0.1)
    assert (fast.brake, fast.turn_brake, fast.hold_brake) == (3.0, 7.0, 5.0)
    assert (fast.react, fast.turn_react, fast.hold_react) == pytest.approx((0.5, 0.45, 0.4))


@CHECK
@given(st.floats(0.01, 5.0), ANGLES, ANGLES)
def test_the_lyapunov_functions_decrease_as_stated(rho, alpha, beta):
    """Compare the stated dV with differences of V along a short drive."""
    assume(rho > 0.05)
    assume(abs(rho - 0.3) > 1e-4)  # V has a kink where h begins to fall
    gains, h = gains_of(DataSheet(), 0.1), 1e-6
    pose = Pose(-rho * math.cos(beta), -rho * math.sin(beta), beta - alpha)
    navigation, theta = navigation_variables(pose), math.remainder(beta - alpha, math.tau)
    assume(all(abs(abs(angle) - math.pi) > 1e-3 for angle in (navigation.alpha, navigation.beta, theta)))
    pose = pose._replace(theta=theta)
    f = profile(rho, gains.brake, gains.react)

    def slope(value, command):
        robot = Robot(pose)
        robot.drive(command, h)
        return (value(robot.pose) - value(pose)) / h

    far = slope(
        lambda one: global_lyapunov(navigation_variables(one)),
        drive_and_steer(navigation, 0.0, FORWARD, gains, UNLIMITED),
    )
    alpha, beta = navigation.alpha, navigation.beta
    drive = -rho * f * math.cos(alpha) ** 2
    fade = -0.5 * 0.8 / 0.3 * f * math.cos(alpha) ** 2 * beta**2 if rho < 0.3 else 0.0
    phi = profile(alpha, gains.turn_brake, gains.turn_react)
    assert far == pytest.approx(drive - alpha * phi + fade, rel=1e-3, abs=1e-4)
    near = slope(
        lambda one: local_lyapunov(navigation_variables(one), one.theta),
        drive_and_hold(navigation, theta, 0.0, gains, UNLIMITED),
    )
    hold = profile(theta, gains.hold_brake, gains.hold_react)
    assert near == pytest.approx(drive - theta * hold, rel=1e-3, abs=1e-4)
