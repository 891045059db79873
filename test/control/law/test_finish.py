"""A lateral error that remains at rest: legs to and fro inside the tolerances, a V beyond them, or a new approach."""

import math
import random

import pytest
from driven import ORIGIN, T_S, Robot, Run
from hypothesis import given, settings
from hypothesis import strategies as st

from diffbot_control.law import controller
from diffbot_control.law.controller import new_memory
from diffbot_control.law.finish import LEAVING, TO_AND_FRO, V_LEG, Standing, next_finish, no_finish
from diffbot_control.law.presets import PRESETS
from diffbot_control.law.regions import OMEGA_L, Switching
from diffbot_core.geometry import Pose
from diffbot_core.uncertainty import Estimate, Uncertainty

TUNED = PRESETS["tuned"]
WAIT, SPEED = TUNED.finish.finish_wait, TUNED.finish.finish_speed
NEAR = new_memory()._replace(switching=Switching(OMEGA_L))
REACHED = NEAR._replace(settling=NEAR.settling._replace(reached=True), reached=True)
FORWARD = TUNED._replace(driving=TUNED.driving._replace(allow_backward=False))


def answered_after(run):
    """Time [s] of the first pose at which the goal counts as reached; inf: none."""
    return next((T_S * index for index, memory in enumerate(run.memories) if memory.reached), math.inf)


def regions(run):
    return {memory.switching.region for memory in run.memories}


@pytest.mark.parametrize(("tolerance", "share"), [(0.03, -0.9), (0.1, 0.99), (0.3, 0.7)])
def test_legs_to_and_fro_work_off_an_error_inside_both_tolerances(tolerance, share):
    config = TUNED._replace(tolerance=TUNED.tolerance._replace(xy_goal_tolerance=tolerance))
    run = Run((0.0, share * tolerance, 0.0), config, 700, memory=NEAR)
    assert abs(run.end.y) < config.finish.finish_begin * tolerance
    assert abs(run.end.x) < 0.01 * tolerance + 0.001
    # One step at the speed of a leg is all that it may overshoot by.
    assert max(run.distances) < tolerance * 1.005
    assert run.largest_heading < 0.75 * config.tolerance.yaw_goal_tolerance
    legs = [command for command, memory in zip(run.commands, run.memories, strict=True) if memory.finish.kind]
    assert max(abs(command.v) for command in legs) <= SPEED + 1e-12
    assert regions(run) == {OMEGA_L}
    assert {memory.finish.kind for memory in run.memories} == {0, TO_AND_FRO}
    assert answered_after(run) == pytest.approx((config.tolerance.settling_steps - 1) * T_S)


@pytest.mark.parametrize(("lateral", "sigma"), [(0.115, 0.008), (-0.12, 0.012), (0.13, 0.02)])
def test_an_error_beyond_the_tolerance_is_worked_off_by_a_v_behind_the_goal(lateral, sigma):
    run = Run((0.0, lateral, 0.0), TUNED, 250, uncertainty=Uncertainty(sigma, 0.012), memory=NEAR)
    begins = next(index for index, memory in enumerate(run.memories) if memory.finish.kind == V_LEG)
    assert begins * T_S == pytest.approx(WAIT, abs=T_S)
    assert all(command.v == pytest.approx(0.0, abs=1e-9) for command in run.commands[:begins])
    # Out far enough for half of the error with the heading 0.3 rad, and in again on the axis: Omega_L is not left.
    assert min(pose.x for pose in run.poses) < -0.9 * 0.5 * abs(lateral) / math.tan(0.3)
    assert max(pose.x for pose in run.poses) < 0.05, "a leg to and fro at most"
    assert run.largest_heading < 0.33
    assert regions(run) == {OMEGA_L}
    assert WAIT < answered_after(run) < 25.0
    assert math.hypot(run.end.x, run.end.y) < 0.065
    # Once the goal counts as reached, only legs that stay inside begin.
    reached = next(index for index, memory in enumerate(run.memories) if memory.reached)
    assert V_LEG not in {memory.finish.kind for memory in run.memories[reached + 50 :]}


@settings(max_examples=200)
@given(
    st.builds(Pose, st.floats(-0.2, 0.2), st.floats(-0.2, 0.2), st.floats(-0.1, 0.1)),
    st.builds(Standing, st.floats(0.0, 10.0), st.booleans(), st.booleans()),
    st.builds(Uncertainty, st.floats(0.0, 0.1), st.floats(0.0, 0.2)),
)
def test_what_begins(local, standing, uncertainty):
    tolerance = TUNED.tolerance
    found = next_finish(no_finish(), local, standing, uncertainty, tolerance, TUNED.finish)
    if found.kind != 0:
        assert standing.rest >= WAIT
        assert found.rest == 0.0
    else:
        assert found == no_finish(standing.rest)
    if found.kind in (V_LEG, LEAVING):
        assert not standing.reached
        assert uncertainty.xy < 0.03
        # The heading is known to 99 % at 0.1 rad / 2.576.
        assert abs(local.y) > (0.1 if found.kind == V_LEG else 0.04) or uncertainty.theta > 0.0388
    if found.kind in (TO_AND_FRO, LEAVING):
        assert abs(local.y) > max(0.04, uncertainty.xy)
    assert standing.allow_backward == (found.kind != LEAVING) or found.kind == 0


def test_a_reached_goal_is_never_left_by_a_v_or_a_new_approach():
    """The estimate wanders beyond the tolerance by less than two deviations."""
    rng = random.Random(1)
    for config in (TUNED, FORWARD):
        memory = REACHED
        for step in range(600):
            lateral = 0.11 if step // 100 % 2 else rng.uniform(-0.115, 0.115)
            estimate = Estimate(Pose(0.0, lateral, rng.uniform(-0.02, 0.02)), Uncertainty(0.01, 0.3))
            memory, command, _ = controller.step(memory, estimate, ORIGIN, T_S, config)
            assert memory.finish.kind in (0, TO_AND_FRO)
            assert memory.switching.region == OMEGA_L
            assert memory.reached
            assert config is TUNED or abs(command.v) < 0.01


def test_legs_that_correct_nothing_end_and_the_robot_rests_again():
    """The estimate of y stays what it is whatever the robot does."""
    robot, memory, legs, rested = Robot((0.0, 0.0, 0.0)), NEAR, [], 0
    for _ in range(600):
        estimate = Estimate(robot.pose._replace(y=0.08), Uncertainty(0.012, 0.012))
        memory, command, _ = controller.step(memory, estimate, ORIGIN, T_S, TUNED)
        robot.drive(command)
        legs.append(memory.finish.legs)
        rested += memory.finish.rest >= WAIT - T_S
    assert max(legs) == 12
    assert legs.count(0) > 2 * WAIT / T_S
    assert rested >= 2
