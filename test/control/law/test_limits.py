"""Limits of the command: kept bounds, kept curvature, no needless slowness."""

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from diffbot_control.law.limits import limit_acceleration, limit_velocity
from diffbot_core.data_sheet import DataSheet
from diffbot_core.kinematics import Twist, WheelGeometry, wheel_speeds

CHECK = settings(max_examples=150)
WHEELS = WheelGeometry(0.05, 0.6)
FREE = DataSheet(math.inf, math.inf, math.inf, math.inf, math.inf)
TWISTS = st.builds(Twist, st.floats(-5.0, 5.0), st.floats(-5.0, 5.0))
BOUNDS = st.floats(0.01, 6.0) | st.just(math.inf)
SHEETS = st.builds(
    lambda v_max, omega_max, wheel_max: FREE._replace(v_max=v_max, omega_max=omega_max, wheel_max=wheel_max),
    BOUNDS,
    BOUNDS,
    BOUNDS | st.floats(1.0, 150.0),
)
SLACK = 1.0 + 1e-12


def used(command, limits):
    """Return how much of each velocity bound a command takes up: at most 1 is allowed."""
    fastest = max(abs(speed) for speed in wheel_speeds(command, WHEELS))
    return max(
        abs(command.v) / limits.v_max,
        abs(command.omega) / limits.omega_max,
        fastest / limits.wheel_max,
    )


@CHECK
@given(TWISTS, SHEETS)
def test_velocity_limits_scale_by_the_largest_factor_allowed(wanted, limits):
    command = limit_velocity(wanted, limits)
    share = used(wanted, limits)
    factor = 1.0 if share <= 1.0 else 1.0 / share
    assert used(command, limits) <= SLACK
    expected = (factor * wanted.v, factor * wanted.omega)
    assert command == pytest.approx(expected, rel=1e-9, abs=1e-300)
    if share <= 1.0:
        assert command == wanted


def reachable(factor, wanted, previous, dt, limits):
    return (
        abs(factor * wanted.v - previous.v) <= limits.a_max * dt + 1e-12
        and abs(factor * wanted.omega - previous.omega) <= limits.omega_dot_max * dt + 1e-12
    )


ACCELERATIONS = st.builds(
    lambda a_max, omega_dot_max: FREE._replace(a_max=a_max, omega_dot_max=omega_dot_max),
    st.floats(0.05, 20.0) | st.just(math.inf),
    st.floats(0.05, 20.0) | st.just(math.inf),
)


@CHECK
@given(TWISTS, TWISTS, ACCELERATIONS, st.sampled_from((0.0, 0.02, 0.1, 1.0)))
def test_acceleration_limits_against_a_search(wanted, previous, limits, dt):
    command = limit_acceleration(wanted, previous, dt, limits)
    room_v = 0.0 if dt == 0.0 else limits.a_max * dt
    room_w = 0.0 if dt == 0.0 else limits.omega_dot_max * dt
    if limits.a_max < math.inf:
        assert abs(command.v - previous.v) <= room_v * SLACK + 1e-12
    if limits.omega_dot_max < math.inf:
        assert abs(command.omega - previous.omega) <= room_w * SLACK + 1e-12
    if dt == 0.0:
        return
    factors = [s / 500 for s in range(501) if reachable(s / 500, wanted, previous, dt, limits)]
    if factors:
        # On the wanted curve, and no point of the search is further along it.
        assert command.v * wanted.omega == pytest.approx(command.omega * wanted.v, abs=1e-9)
        size = math.hypot(*wanted)
        assert math.hypot(*command) >= factors[-1] * size * (1.0 - 1e-9) - 1e-12
        assert math.hypot(*command) <= size * SLACK


@pytest.mark.parametrize(
    ("previous", "wanted", "expected"),
    [
        # From rest along the wanted curve: a_max alone, 0.1 of the way.
        (Twist(0.0, 0.0), Twist(1.0, 0.5), (0.1, 0.05)),
        # omega_dot_max = 2 binds: 0.2 of 2 rad/s.
        (Twist(0.0, 0.0), Twist(1.0, 2.0), (0.1, 0.2)),
        (Twist(0.0, 0.0), Twist(1.0, 4.0), (0.05, 0.2)),
        # Reversing has no curve in common: each velocity for itself.
        (Twist(1.0, 0.0), Twist(-1.0, 1.0), (0.9, 0.2)),
        (Twist(0.05, 0.0), Twist(-1.0, 0.0), (-0.05, 0.0)),
        # Stopping: likewise.
        (Twist(1.0, 0.1), Twist(0.0, 0.0), (0.9, 0.0)),
        (Twist(0.1, -0.2), Twist(0.0, 0.0), (0.0, 0.0)),
        # Turning on the spot from driving on.
        (Twist(1.0, 0.0), Twist(0.0, 1.0), (0.9, 0.2)),
        (Twist(0.7, -0.3), Twist(0.7, -0.3), (0.7, -0.3)),
    ],
)
def test_acceleration_limits_by_hand(previous, wanted, expected):
    limits = FREE._replace(a_max=1.0, omega_dot_max=2.0)
    assert limit_acceleration(wanted, previous, 0.1, limits) == pytest.approx(expected, abs=1e-12)


@CHECK
@given(TWISTS, TWISTS, ACCELERATIONS)
def test_any_command_is_reached_in_the_steps_it_takes(wanted, start, limits):
    dt = 0.1
    steps_v = 0 if limits.a_max == math.inf else math.ceil(abs(wanted.v - start.v) / limits.a_max / dt)
    span = abs(wanted.omega - start.omega)
    steps_w = 0 if limits.omega_dot_max == math.inf else math.ceil(span / limits.omega_dot_max / dt)
    now = start
    for _ in range(2 * (steps_v + steps_w) + 2):
        now = limit_acceleration(wanted, now, dt, limits)
    assert now == pytest.approx(wanted, abs=1e-12)
