"""Limits of the command: bounds, curvature, the largest possible command, random drives with bounds that change."""

import math
import random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from diffbot_control.law.law import CONTACT_UNKNOWN, Observation
from diffbot_control.law.limits import limit_acceleration, limit_velocity, slowed
from diffbot_control.law.registry import PRESETS
from diffbot_core.data_sheet import DataSheet, rim_speed
from diffbot_core.geometry import Pose
from diffbot_core.kinematics import Twist, WheelGeometry, wheel_speeds
from diffbot_core.uncertainty import Estimate, Uncertainty

CHECK = settings(max_examples=150)
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
    """Return the largest ratio of a velocity to its bound; at most 1 is allowed."""
    fastest = max(abs(speed) for speed in wheel_speeds(command, WheelGeometry(0.05, 0.6)))
    return max(abs(command.v) / limits.v_max, abs(command.omega) / limits.omega_max, fastest / limits.wheel_max)


@CHECK
@given(TWISTS, SHEETS)
def test_velocity_limits_scale_by_the_largest_factor_allowed(requested, limits):
    command = limit_velocity(requested, limits)
    share = used(requested, limits)
    factor = 1.0 if share <= 1.0 else 1.0 / share
    assert used(command, limits) <= SLACK
    expected = (factor * requested.v, factor * requested.omega)
    assert command == pytest.approx(expected, rel=1e-9, abs=1e-300)
    if share <= 1.0:
        assert command == requested


def reachable(factor, requested, previous, dt, limits):
    return (
        abs(factor * requested.v - previous.v) <= limits.a_max * dt + 1e-12
        and abs(factor * requested.omega - previous.omega) <= limits.omega_dot_max * dt + 1e-12
    )


ACCELERATIONS = st.builds(
    lambda a_max, omega_dot_max: FREE._replace(a_max=a_max, omega_dot_max=omega_dot_max),
    st.floats(0.05, 20.0) | st.just(math.inf),
    st.floats(0.05, 20.0) | st.just(math.inf),
)


@CHECK
@given(TWISTS, TWISTS, ACCELERATIONS, st.sampled_from((0.0, 0.02, 0.1, 1.0)))
def test_acceleration_limits_keep_the_curve_and_as_much_speed_as_a_search_finds(requested, previous, limits, dt):
    command = limit_acceleration(requested, previous, dt, limits)
    room_v = 0.0 if dt == 0.0 else limits.a_max * dt
    room_w = 0.0 if dt == 0.0 else limits.omega_dot_max * dt
    if limits.a_max < math.inf:
        assert abs(command.v - previous.v) <= room_v * SLACK + 1e-12
    if limits.omega_dot_max < math.inf:
        assert abs(command.omega - previous.omega) <= room_w * SLACK + 1e-12
    if dt == 0.0:
        return
    factors = [s / 500 for s in range(501) if reachable(s / 500, requested, previous, dt, limits)]
    if factors:
        # The command is on the requested curve, and at least as fast as each command of the search.
        assert command.v * requested.omega == pytest.approx(command.omega * requested.v, abs=1e-9)
        size = math.hypot(*requested)
        assert math.hypot(*command) >= factors[-1] * size * (1.0 - 1e-9) - 1e-12
        assert math.hypot(*command) <= size * SLACK


TOLERANCE = 1e-12


def some_sheet(rng):
    def bound(low, high, share_without=0.15):
        return math.inf if rng.random() < share_without else low * (high / low) ** rng.random()

    wheels = WheelGeometry(rng.uniform(0.02, 0.3), rng.uniform(0.1, 1.5))
    accelerations = bound(0.05, 20.0), bound(0.05, 60.0)
    between = rng.choice((0.0, 0.25)), rng.choice((0.0, 0.1)), rng.choice((0.0, 0.05)), rng.choice((0.0, 0.05))
    return DataSheet(bound(0.05, 5.0), bound(0.05, 12.0), bound(0.5, 100.0), *accelerations, wheels, *between)


def excess_over(velocities, sheet):
    """Return by how much |v|, |omega| and the faster rim exceed their bounds; <= 0 within the bounds."""
    v, omega = map(abs, velocities)
    rim = v + 0.5 * sheet.wheels.wheel_separation * omega
    return v - sheet.v_max, omega - sheet.omega_max, rim - rim_speed(sheet)


def assert_holds(command, last, dt, sheet):
    """Check that no velocity changes too fast, and that a command beyond a bound brakes as hard as possible."""
    changes = sheet.a_max * dt, sheet.omega_dot_max * dt
    slowest = [max(abs(one) - change, 0.0) for one, change in zip(last, changes, strict=True)]
    for now, before, change in zip(command, last, changes, strict=True):
        assert abs(now - before) <= change + TOLERANCE
    for found, forced in zip(excess_over(command, sheet), excess_over(slowest, sheet), strict=True):
        assert found <= max(forced, 0.0) + TOLERANCE


@pytest.mark.parametrize("preset", PRESETS)
def test_no_bound_is_broken_by_the_whole_law(preset):
    for seed in range(10):
        rng = random.Random(seed)
        law, config = PRESETS[preset]
        config = config._replace(data_sheet=some_sheet(rng))
        memory = law.new_memory(config)
        for _ in range(150):
            if rng.random() < 0.1:
                config = config._replace(data_sheet=some_sheet(rng))
            sheet, last = config.data_sheet, memory.command
            pose = Pose(rng.gauss(0.0, 1.0), rng.gauss(0.0, 1.0), rng.uniform(-math.pi, math.pi))
            if rng.random() < 0.1:
                command = slowed(memory.command, 0.1, sheet)
                memory = law.after_command(memory, command, 0.1, config)
            else:
                seen = Observation(Estimate(pose, Uncertainty(0.02, 0.02)), 0.1, 0.1, CONTACT_UNKNOWN)
                memory, command, _ = law.step(memory, seen, Pose(0.0, 0.0, 0.0), config)
            assert_holds(command, last, 0.1, sheet)
