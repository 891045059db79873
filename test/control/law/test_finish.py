"""A lateral error that remains at rest: worked off inside the tolerance, or by going out and in again."""

import math
import random

import pytest
from driven import ORIGIN, T_S, Run

from diffbot_control.law import controller
from diffbot_control.law.controller import new_memory
from diffbot_control.law.presets import PRESETS
from diffbot_control.law.regions import OMEGA_L, Switching
from diffbot_core.geometry import Pose
from diffbot_core.uncertainty import CERTAIN, Estimate, Uncertainty

TUNED = PRESETS["tuned"]
NEAR = new_memory()._replace(switching=Switching(OMEGA_L))
FORWARD = TUNED._replace(driving=TUNED.driving._replace(allow_backward=False))


def held_in_omega_l(tolerance, **finish):
    """The default law with this tolerance, and an Omega_L that is left by nothing that the finish does."""
    covariance = TUNED.region_policy.covariance._replace(eps_P_min=2.5 * tolerance, eps_P_leave_min=10.0)
    return TUNED._replace(
        tolerance=TUNED.tolerance._replace(xy_goal_tolerance=tolerance),
        region_policy=TUNED.region_policy._replace(covariance=covariance),
        finish=TUNED.finish._replace(**finish),
    )


@pytest.mark.parametrize("tolerance", [0.05, 0.3])
@pytest.mark.parametrize("share", [-0.9, -0.5, 0.3, 0.7, 0.93])
def test_an_error_within_the_tolerance_is_worked_off_without_leaving_it_before_the_goal_is_reached(tolerance, share):
    config, sigma = held_in_omega_l(tolerance), 0.02 * tolerance
    run = Run((0.0, share * tolerance, 0.0), config, 900, uncertainty=Uncertainty(sigma, 0.002))
    assert run.memories[-1].reached
    assert abs(run.end.y) < 0.25 * tolerance
    first = next(index for index, memory in enumerate(run.memories) if memory.reached)
    assert abs(run.poses[first].y) < 0.25 * tolerance
    assert max(run.distances) < tolerance
    # The heading stays within half of its tolerance, but for what the control overshoots by.
    assert run.largest_heading < 0.06


def test_the_mirror_image_does_the_mirror_image():
    run, mirrored = (Run((0.0, y, turn), held_in_omega_l(0.1), 300) for y, turn in ((0.07, 0.03), (-0.07, -0.03)))
    for (x, y, theta), mirror in zip(run.poses, mirrored.poses, strict=True):
        assert mirror == pytest.approx((x, -y, -theta), abs=1e-9)


def test_an_error_beyond_the_tolerance_is_worked_off_by_going_out_along_the_axis_and_in_again():
    run = Run((0.0, -0.19, 0.0), held_in_omega_l(0.1), 900, uncertainty=Uncertainty(0.002, 0.002))
    assert run.memories[-1].reached
    assert abs(run.end.y) < 0.025
    assert 0.19 < max(run.distances) < 1.0
    assert min(pose.x for pose in run.poses) < -0.1, "backwards"
    assert run.largest_heading < 0.4


def first_motion(lateral, sigma, config, seconds=12.0):
    """Stand beside the goal; return when [s] the command is to drive, inf if it never is, and the memory then."""
    memory, estimate = NEAR, Estimate(Pose(0.0, lateral, 0.0), Uncertainty(sigma, 0.01))
    for step in range(round(seconds / T_S)):
        memory, command, _ = controller.step(memory, estimate, ORIGIN, T_S, config)
        if abs(command.v) > 1e-9:
            return step * T_S, memory
    return math.inf, memory


@pytest.mark.parametrize(
    ("lateral", "sigma", "earliest", "latest", "leaves"),
    [
        (0.06, 0.04, 5.5, 7.0, False),  # at first it waits for a better estimate
        (0.06, 0.09, math.inf, math.inf, False),  # not even one deviation of room for the shortest leg
        (0.12, 0.02, 0.0, 1.0, False),  # the goal will count as reached: no reason to leave
        (0.12, 0.06, 5.5, 7.0, True),  # nearer than one deviation to the tolerance
        (0.16, 0.06, 0.0, 1.0, True),  # 2.7 deviations are no accident
        (0.16, 0.14, math.inf, math.inf, False),
        (0.03, 0.01, math.inf, math.inf, False),  # a quarter of the tolerance is good enough
    ],
)
def test_when_it_begins_depends_on_error_and_uncertainty_and_whether_it_leaves_too(
    lateral, sigma, earliest, latest, leaves
):
    config = held_in_omega_l(0.15)
    begins, memory = first_motion(lateral, sigma, config)
    assert earliest <= begins <= latest
    if begins < math.inf:
        run = Run((0.0, lateral, 0.0), config, 100, uncertainty=Uncertainty(sigma, 0.01), memory=memory)
        assert (max(run.distances) > lateral + 0.1) is leaves
        if not leaves:
            assert max(abs(command.v) for command in run.commands[:20]) <= config.finish.finish_speed + 1e-12


def test_it_begins_after_settling_steps_at_rest_and_the_goal_is_not_reached_meanwhile():
    config = held_in_omega_l(0.1)
    begins, memory = first_motion(0.03, 0.01, config)
    assert begins == pytest.approx((config.tolerance.settling_steps - 1) * T_S, abs=2.0 * T_S)
    assert not memory.reached
    patient = config._replace(tolerance=config.tolerance._replace(settling_steps=20))
    assert first_motion(0.03, 0.01, patient)[0] == pytest.approx(begins + 1.5)


@pytest.mark.parametrize("config", [held_in_omega_l(0.1, finish_tries=0), FORWARD], ids=["no tries", "forward only"])
def test_switched_off_it_stays_where_it_rests_and_the_goal_is_reached(config):
    run = Run((0.0, 0.06, 0.0), config, 100, memory=NEAR)
    assert run.end == pytest.approx((0.0, 0.06, 0.0), abs=1e-9)
    assert run.memories[-1].reached


@pytest.mark.parametrize(("window", "moves"), [(6.0, True), (1.5, False)])
def test_no_try_begins_after_its_window(window, moves):
    # The position is known only after 2 s.
    config, known = held_in_omega_l(0.1, finish_window=window), lambda step: Uncertainty(0.5 if step < 20 else 0.0, 0.0)
    run = Run((0.0, 0.06, 0.0), config, 200, uncertainty=known)
    assert (abs(run.end.y) < 0.03) is moves


def test_the_number_of_tries_is_bounded_whatever_the_error_does():
    config, memory, worked_off = held_in_omega_l(0.1, finish_tries=2, finish_window=3600.0), NEAR, []
    for _ in range(4):
        # Pushed aside each time that it has come to rest.
        run = Run((0.0, 0.06, 0.0), config, 300, memory=memory)
        memory = run.memories[-1]._replace(settling=NEAR.settling, reached=False)
        worked_off.append(abs(run.end.y) < 0.03)
    assert worked_off[0]
    assert not worked_off[-1]
    assert run.end == pytest.approx((0.0, 0.06, 0.0), abs=1e-9)


def test_nothing_begins_once_the_goal_is_reached():
    """The estimate wanders through the whole tolerance, and the commands are those of a law without a finish."""
    rng, without = random.Random(1), TUNED._replace(finish=TUNED.finish._replace(finish_tries=0))
    for _ in range(10):
        memory = Run((0.001, 0.002, 0.0), TUNED, 8).memories[-1]
        assert memory.reached
        for _ in range(200):
            angle, far = rng.uniform(-math.pi, math.pi), rng.uniform(0.0, 0.099)
            pose = Pose(far * math.cos(angle), far * math.sin(angle), rng.uniform(-0.02, 0.02))
            estimate = Estimate(pose, Uncertainty(0.01, 0.01))
            _, expected, _ = controller.step(memory, estimate, ORIGIN, T_S, without)
            memory, command, _ = controller.step(memory, estimate, ORIGIN, T_S, TUNED)
            assert command == expected
            assert memory.switching.region == OMEGA_L


def test_one_pose_beyond_the_tolerance_begins_no_way_out():
    known = Uncertainty(0.01, 0.005)
    memory = NEAR
    for lateral in [0.08] * (TUNED.tolerance.settling_steps - 1) + [0.13]:
        memory, command, _ = controller.step(memory, Estimate(Pose(0.0, lateral, 0.0), known), ORIGIN, T_S, TUNED)
    assert command.v == pytest.approx(0.0, abs=1e-9)
    # Nor does it turn a try that is under way into one.
    begun = Run((0.0, 0.08, 0.0), TUNED, 12, uncertainty=known, memory=NEAR)
    assert abs(begun.commands[-1].v) > 0.0
    thrown = Estimate(Pose(begun.end.x, 0.13, begun.end.theta), known)
    memory, _, _ = controller.step(begun.memories[-1], thrown, ORIGIN, T_S, TUNED)
    after = Run(begun.end, TUNED, 600, uncertainty=known, memory=memory)
    assert max(after.distances) < 0.1
    assert abs(after.end.y) < 0.025


def test_a_new_goal_forgets_a_try():
    run = Run((0.0, 0.08, 0.0), held_in_omega_l(0.1), 12, uncertainty=CERTAIN)
    assert abs(run.commands[-1].v) > 0.0
    memory = controller.memory_for_new_goal(run.memories[-1])
    assert memory == new_memory()._replace(command=memory.command)
