"""Goals, silence and coming to rest: the supervisor's states, by stories with made-up time."""

import math

import pytest

from diffbot_control.law import controller
from diffbot_control.law.controller import ControllerConfig, ControllerMemory
from diffbot_control.law.presets import PRESETS
from diffbot_control.law.regions import OMEGA_G, OMEGA_L
from diffbot_control.law.supervisor import (
    DRIVING,
    IDLE,
    NOT_REACHED,
    REACHED,
    STALE,
    STATES,
    UNCERTAIN,
    WAITING,
    Supervisor,
    SupervisorConfig,
)
from diffbot_core.data_sheet import PAPER_DATA_SHEET
from diffbot_core.geometry import Pose
from diffbot_core.uncertainty import CERTAIN, Estimate, Uncertainty

ZERO = (0.0, 0.0)
GOAL = Pose(0.0, 0.0, 0.0)
AWAY = Pose(-3.0, 0.0, 0.0)
AT_GOAL = Pose(-0.01, 0.0, 0.0)
PAPER = PRESETS["paper"]
QUICK = PAPER._replace(tolerance=PAPER.tolerance._replace(settling_steps=2))
SLOW_DOWN = PAPER._replace(data_sheet=PAPER_DATA_SHEET._replace(a_max=1.0))
UNSURE = Uncertainty(0.3, 0.01)
"""Twice that does not fit into the 0.4 m of the paper's preset."""


def step(memory, pose, goal, dt, config, uncertainty=CERTAIN):
    """Step with the pose and its uncertainty side by side."""
    return controller.step(memory, Estimate(pose, uncertainty), goal, dt, config)


class Story:
    """A supervisor with a clock; poses are stamped with it."""

    def __init__(self, **options):
        self.supervisor = Supervisor(SupervisorConfig(**options))
        self.now = 100.0

    def pose(self, pose=AWAY, after=0.1, uncertainty=CERTAIN):
        self.now += after
        return self.supervisor.on_pose(round(self.now * 1e9), self.now, pose, uncertainty)

    def again(self, pose=AWAY, uncertainty=CERTAIN):
        """Send the last pose a second time, a little later."""
        return self.supervisor.on_pose(round(self.now * 1e9), self.now + 0.03, pose, uncertainty)

    def tick(self, after=0.1):
        self.now += after
        return self.supervisor.on_tick(self.now)

    @property
    def state(self):
        return self.supervisor.state


def test_the_documented_states():
    assert STATES == (
        "idle",
        "waiting for pose",
        "driving",
        "goal reached",
        "tolerance below uncertainty",
        "stale pose",
        "goal not reached",
    )


def test_it_starts_idle_and_silent():
    story = Story()
    assert story.state == IDLE
    assert story.pose() is None
    assert story.tick(10.0) is None
    assert story.supervisor.on_cancel() is None
    assert story.state == IDLE


def test_a_goal_before_any_pose_waits():
    story = Story()
    story.supervisor.on_goal(GOAL)
    assert story.state == WAITING
    assert story.tick(10.0) is None
    assert story.state == WAITING
    command = story.pose()
    assert story.state == DRIVING
    assert command == pytest.approx((1.3, 0.0))


def test_each_pose_is_answered_with_the_controllers_step():
    story = Story()
    story.supervisor.on_goal(GOAL)
    memory = ControllerMemory()
    for number in range(5):
        pose = Pose(-3.0 + 0.1 * number, 0.4, 0.2)
        memory, expected, report = step(memory, pose, GOAL, 0.1, ControllerConfig())
        assert story.pose(pose) == expected
        assert story.supervisor.memory == memory
        assert story.supervisor.report == report


def test_the_time_between_stamps_goes_to_the_acceleration_limits():
    story = Story(controller=SLOW_DOWN)
    story.supervisor.on_goal(GOAL)
    # No time has passed before the first pose; then 0.1 s, 0.3 s; a gap counts for at most 1 s.
    far = Pose(-50.0, 0.0, 0.0)
    speeds = [story.pose(far, after).v for after in (0.1, 0.1, 0.3, 0.0)]
    assert speeds == pytest.approx([0.0, 0.1, 0.4, 0.4])
    assert story.pose(far, 0.25).v == pytest.approx(0.65)
    story = Story(controller=PAPER._replace(data_sheet=PAPER_DATA_SHEET._replace(a_max=0.1)))
    story.supervisor.on_goal(GOAL)
    story.pose(far)
    assert story.pose(far, 30.0).v == pytest.approx(0.1)


def test_stamps_that_go_back_give_no_room_to_accelerate():
    story = Story(controller=SLOW_DOWN)
    supervisor = story.supervisor
    supervisor.on_goal(GOAL)
    supervisor.on_pose(10 * 10**9, 1.0, AWAY)
    assert supervisor.on_pose(10 * 10**9 + 10**8, 1.1, AWAY).v == pytest.approx(0.1)
    assert supervisor.on_pose(2 * 10**9, 1.2, AWAY).v == pytest.approx(0.1)
    assert supervisor.on_pose(2 * 10**9 + 10**8, 1.3, AWAY).v == pytest.approx(0.2)


def reach(story):
    """Drive a story with settling_steps = 2 to its goal."""
    story.pose(AT_GOAL)
    assert story.state == DRIVING
    command = story.pose(AT_GOAL)
    assert story.state == REACHED
    return command


def test_a_held_goal_is_still_controlled():
    story = Story(controller=QUICK)
    story.supervisor.on_goal(GOAL)
    reach(story)
    assert story.supervisor.goals_reached == 1
    command = story.pose(AWAY)
    assert command.v == pytest.approx(1.3 * math.tanh(3.0))
    # Stateful: pushed away, it comes back, but the goal stays reached and counts once.
    assert story.state == REACHED
    story.pose(AT_GOAL)
    assert story.supervisor.goals_reached == 1


def test_without_stateful_a_goal_can_be_lost_but_counts_once():
    tolerance = PAPER.tolerance._replace(settling_steps=2, stateful=False)
    story = Story(controller=PAPER._replace(tolerance=tolerance))
    story.supervisor.on_goal(GOAL)
    reach(story)
    story.pose(AWAY)
    assert story.state == DRIVING
    reach(story)
    assert story.supervisor.goals_reached == 1


def test_silence_at_a_reached_goal_does_not_count_it_again():
    story = Story(controller=QUICK)
    story.supervisor.on_goal(GOAL)
    reach(story)
    assert story.tick(1.0) == ZERO
    assert story.state == STALE
    story.pose(AT_GOAL)
    assert story.state == REACHED
    assert story.supervisor.goals_reached == 1


def test_goals_reached_counts_each_goal():
    story = Story(controller=QUICK)
    for count in (1, 2, 3):
        story.supervisor.on_goal(GOAL)
        reach(story)
        assert story.supervisor.goals_reached == count


def test_a_goal_that_is_not_held_ends_in_rest_and_silence():
    story = Story(controller=QUICK, hold_goal=False)
    story.supervisor.on_goal(GOAL)
    command = reach(story)
    assert command is not None
    assert story.supervisor.goal is None
    answers = [story.pose(AWAY) for _ in range(8)]
    assert answers == [ZERO] * 5 + [None] * 3
    assert story.state == REACHED
    assert story.supervisor.goals_reached == 1


def test_cancelling_stops_at_once_says_so_five_times_and_is_silent():
    story = Story()
    story.supervisor.on_goal(GOAL)
    story.pose()
    assert story.supervisor.on_cancel() == ZERO
    assert story.state == IDLE
    assert story.supervisor.goal is None
    assert story.supervisor.report is None
    assert [story.pose() for _ in range(6)] == [ZERO] * 4 + [None] * 2
    assert story.supervisor.on_cancel() is None


def test_cancelling_keeps_the_acceleration_limits():
    story = Story(controller=SLOW_DOWN)
    story.supervisor.on_goal(GOAL)
    for _ in range(4):
        command = story.pose(Pose(-50.0, 0.0, 0.0))
    assert command.v == pytest.approx(0.3)
    speeds = [story.supervisor.on_cancel().v]
    speeds += [story.pose().v for _ in range(3)]
    assert speeds == pytest.approx([0.3, 0.2, 0.1, 0.0])
    answers = [story.pose() for _ in range(8)]
    assert answers[:4] == [ZERO] * 4
    assert answers[-2:] == [None] * 2


def test_a_cancelled_goal_without_poses_is_stopped_by_the_watch():
    story = Story(controller=SLOW_DOWN)
    story.supervisor.on_goal(GOAL)
    for _ in range(4):
        story.pose(Pose(-50.0, 0.0, 0.0))
    story.supervisor.on_cancel()
    # Silent up to pose_timeout, then zero a few times, then silent for good.
    assert story.tick(0.4) is None
    answers = [story.tick() for _ in range(12)]
    assert answers[0] is None
    sent = [answer for answer in answers if answer is not None]
    assert sent == [ZERO] * 5
    assert answers[-1] is None
    assert story.state == IDLE


def test_cancelling_in_lock_step_leaves_the_answer_to_the_next_pose():
    story = Story(publish_when_idle=True)
    story.supervisor.on_goal(GOAL)
    story.pose()
    assert story.supervisor.on_cancel() is None
    assert [story.pose() for _ in range(20)] == [ZERO] * 20


def test_publish_when_idle_answers_every_pose():
    story = Story(publish_when_idle=True)
    assert [story.pose() for _ in range(7)] == [ZERO] * 7
    assert story.state == IDLE


@pytest.mark.parametrize("timeout", [0.2, 0.5, 2.0])
def test_the_watch_stops_a_robot_without_poses(timeout):
    story = Story(pose_timeout=timeout)
    story.supervisor.on_goal(GOAL)
    story.pose()
    last = story.now
    assert story.supervisor.on_tick(last + timeout - 1e-6) is None
    assert story.state == DRIVING
    assert story.supervisor.on_tick(last + timeout + 1e-6) == ZERO
    assert story.state == STALE
    # It goes on saying so: one lost message must not matter.
    assert [story.supervisor.on_tick(last + timeout + n) for n in range(1, 9)] == [ZERO] * 8
    assert story.supervisor.memory.command == ZERO
    story.now = last + 20.0
    assert story.pose().v == 1.3
    assert story.state == DRIVING


def test_steps_towards_reaching_start_anew_after_silence():
    story = Story(controller=QUICK)
    story.supervisor.on_goal(GOAL)
    story.pose(AT_GOAL)
    story.tick(1.0)
    story.pose(AT_GOAL)
    assert story.state == DRIVING
    story.pose(AT_GOAL)
    assert story.state == REACHED


def test_a_stale_robot_can_be_given_up():
    story = Story()
    story.supervisor.on_goal(GOAL)
    story.pose()
    story.tick(1.0)
    assert story.state == STALE
    assert story.supervisor.on_cancel() == ZERO
    assert story.state == IDLE


def test_a_new_goal_while_driving_wins():
    story = Story(controller=SLOW_DOWN)
    story.supervisor.on_goal(GOAL)
    for _ in range(4):
        story.pose(Pose(-50.0, 0.0, 0.0))
    assert story.supervisor.memory.command.v == pytest.approx(0.3)
    behind = Pose(-100.0, 0.0, 0.0)
    story.supervisor.on_goal(behind)
    assert story.state == DRIVING
    assert story.supervisor.report is None
    # The motion is not forgotten: it brakes from 0.3 m/s before it reverses.
    speeds = [story.pose(Pose(-50.0, 0.0, 0.0)).v for _ in range(5)]
    assert speeds == pytest.approx([0.2, 0.1, 0.0, -0.1, -0.2], abs=1e-9)
    assert story.supervisor.report.rho == pytest.approx(50.0)


def test_a_new_goal_after_a_reached_one_drives_again():
    story = Story(controller=QUICK)
    story.supervisor.on_goal(GOAL)
    reach(story)
    story.supervisor.on_goal(Pose(5.0, 0.0, 0.0))
    assert story.state == DRIVING
    story.pose(AT_GOAL)
    assert story.state == DRIVING
    assert story.supervisor.memory.reached is False
    assert story.supervisor.report.rho == pytest.approx(5.01)


def test_time_that_jumps_back_does_not_silence_the_watch():
    story = Story()
    story.supervisor.on_goal(GOAL)
    story.pose()
    assert story.supervisor.on_tick(3.0) is None
    assert story.supervisor.on_tick(3.4) is None
    assert story.supervisor.on_tick(3.6) == ZERO
    assert story.state == STALE


@pytest.mark.parametrize("hold", [True, False])
@pytest.mark.parametrize("when_idle", [True, False])
def test_every_state_reached_is_a_documented_one(hold, when_idle):
    story = Story(controller=QUICK, hold_goal=hold, publish_when_idle=when_idle, goal_timeout=0.3)
    story.supervisor.on_goal(GOAL)
    states, number = {story.state}, 7
    actions = (
        lambda: story.pose(AT_GOAL),
        lambda: story.pose(AT_GOAL, uncertainty=UNSURE),
        lambda: story.pose(AWAY),
        lambda: story.tick(0.1),
        lambda: story.tick(1.0),
        lambda: story.supervisor.on_goal(GOAL),
        story.supervisor.on_cancel,
    )
    for _ in range(3000):
        number = (1103515245 * number + 12345) % 2**31
        command = actions[(number >> 16) % len(actions)]()
        states.add(story.state)
        assert command is None or all(math.isfinite(value) for value in command)
        if story.supervisor.goal is None:
            assert command in (None, ZERO) or story.state in (REACHED, NOT_REACHED)
        else:
            assert story.state in (WAITING, DRIVING, REACHED, UNCERTAIN, STALE)
    assert states == set(STATES)


@pytest.mark.parametrize("uncertainty", [UNSURE, Uncertainty(0.01, 0.06), Uncertainty(9.0, 9.0)])
def test_a_tolerance_below_the_uncertainty_is_reported_at_rest_only(uncertainty):
    story = Story(controller=QUICK)
    story.supervisor.on_goal(GOAL)
    story.pose(AWAY, uncertainty=uncertainty)
    assert story.state == DRIVING, "far away"
    story.pose(Pose(-0.3, 0.0, 0.0), uncertainty=uncertainty)
    assert story.state == DRIVING, "near, and moving"
    story.pose(Pose(0.0, 0.0, 0.09), uncertainty=uncertainty)
    assert story.state == DRIVING, "near, and turning"
    for _ in range(5):
        story.pose(AT_GOAL, uncertainty=uncertainty)
        assert story.state == UNCERTAIN
    assert story.supervisor.goals_reached == 0
    # Known better, it is reached after the two poses that it takes.
    story.pose(AT_GOAL)
    assert story.state == DRIVING
    story.pose(AT_GOAL)
    assert story.state == REACHED
    # A reached goal stays reached.
    story.pose(AT_GOAL, uncertainty=uncertainty)
    assert story.state == REACHED


def test_an_uncertainty_that_fits_is_not_complained_of():
    story = Story(controller=QUICK)
    story.supervisor.on_goal(GOAL)
    # Resting abreast, outside the tolerance with its two sigmas: not reached, but it could be.
    for _ in range(4):
        story.pose(Pose(0.0, 0.35, 0.0), uncertainty=Uncertainty(0.19, 0.04))
        assert story.state == DRIVING


def test_standing_in_omega_g_is_not_resting():
    # Abreast of the goal, far away: the command is small only where a turn has just ended.
    config = PRESETS["paper"]._replace(data_sheet=PAPER_DATA_SHEET._replace(v_max=0.01, omega_max=0.01))
    story = Story(controller=config)
    story.supervisor.on_goal(GOAL)
    story.pose(AWAY, uncertainty=UNSURE)
    assert story.supervisor.memory.switching.region == OMEGA_G
    assert story.state == DRIVING


def test_the_smallest_tolerance_is_what_the_covariance_allows():
    story = Story(controller=PAPER._replace(tolerance=PAPER.tolerance._replace(goal_sigmas=3.0)))
    assert story.supervisor.smallest_tolerance() == (0.0, 0.0)
    story.supervisor.on_goal(GOAL)
    story.pose(AWAY, uncertainty=Uncertainty(0.2, 0.03))
    assert story.supervisor.smallest_tolerance() == pytest.approx((0.6, 0.09))
    story.pose(AWAY)
    assert story.supervisor.smallest_tolerance() == (0.0, 0.0)


def test_the_uncertainty_of_the_pose_goes_to_the_controller():
    config = PRESETS["tuned"]
    story, memory = Story(controller=config), ControllerMemory()
    story.supervisor.on_goal(GOAL)
    for number in range(8):
        uncertainty = Uncertainty(0.03 * number, 0.01)
        pose = Pose(-0.25, 0.02 * number, 0.1)
        memory, expected, report = step(memory, pose, GOAL, 0.1, config, uncertainty)
        assert story.pose(pose, uncertainty=uncertainty) == expected
        assert (story.supervisor.memory, story.supervisor.report) == (memory, report)
    assert memory.switching.region == OMEGA_L


@pytest.mark.parametrize("config", [QUICK, SLOW_DOWN, PRESETS["tuned"]])
def test_a_pose_that_is_sent_again_has_the_same_answer_and_counts_for_nothing(config):
    story, twin = Story(controller=config), Story(controller=config)
    poses = [AWAY, Pose(-1.0, 0.2, 0.3), Pose(-0.2, 0.1, 0.0), *[Pose(0.0, 0.09, 0.0)] * 12, AWAY, AWAY, AWAY]
    for one in (story, twin):
        one.supervisor.on_goal(GOAL)
    for pose in poses:
        answer = story.pose(pose)
        assert twin.pose(pose) == answer
        for _ in range(3):
            assert twin.again(pose) == answer
        assert twin.supervisor.memory == story.supervisor.memory
        assert twin.supervisor.report == story.supervisor.report
        assert (twin.state, twin.supervisor.goals_reached) == (story.state, story.supervisor.goals_reached)


def test_the_same_place_at_another_time_is_a_step_of_its_own():
    story = Story(controller=QUICK)
    story.supervisor.on_goal(GOAL)
    reach(story)
    # And another place at the same time as well.
    story = Story(controller=QUICK)
    story.supervisor.on_goal(GOAL)
    story.pose(AWAY)
    assert story.again(Pose(-2.0, 0.0, 0.0)).v == pytest.approx(1.3 * math.tanh(2.0))


@pytest.mark.parametrize("config", [QUICK, SLOW_DOWN, PRESETS["tuned"]])
def test_a_corrected_pose_of_the_same_time_takes_the_place_of_the_first(config):
    story, twin = Story(controller=config), Story(controller=config)
    poses = [AWAY, Pose(-1.0, 0.2, 0.3), Pose(-0.2, 0.1, 0.0), *[Pose(0.0, 0.09, 0.0)] * 12, AWAY, AWAY, AWAY]
    for one in (story, twin):
        one.supervisor.on_goal(GOAL)
    for pose in poses:
        answer = story.pose(pose, uncertainty=UNSURE)
        twin.pose(pose._replace(x=pose.x + 0.3, theta=1.0))
        for _ in range(3):
            assert twin.again(pose, UNSURE) == answer
        assert twin.supervisor.memory == story.supervisor.memory
        assert twin.supervisor.report == story.supervisor.report
        assert twin.state == story.state


def test_a_corrected_pose_after_a_waypoint_was_passed_counts_for_the_next():
    story, twin = Story(waypoint_radius=2.0), Story()
    story.supervisor.on_path([GOAL, ROUTE[0]])
    story.pose(Pose(-1.0, 0.0, 0.0))
    assert story.supervisor.waypoint == 2
    twin.supervisor.on_goal(ROUTE[0])
    assert story.again(AWAY) == twin.pose(AWAY)
    assert story.supervisor.waypoint == 2


def test_a_pose_sent_again_keeps_the_watch_quiet():
    story = Story()
    story.supervisor.on_goal(GOAL)
    command = story.pose()
    story.now += 0.45
    assert story.supervisor.on_pose(round((story.now - 0.45) * 1e9), story.now, AWAY) == command
    assert story.tick(0.4) is None
    assert story.tick(0.2) == ZERO


def test_a_pose_sent_again_after_silence_or_for_another_goal_is_answered_anew():
    story = Story(controller=QUICK)
    story.supervisor.on_goal(GOAL)
    command = story.pose()
    assert story.tick(1.0) == ZERO
    assert story.supervisor.on_pose(round((story.now - 1.0) * 1e9), story.now, AWAY) == command
    assert story.state == DRIVING
    story.pose()
    story.supervisor.on_goal(Pose(-6.0, 0.0, 0.0))
    assert story.again().v == pytest.approx(-1.3 * math.tanh(3.0))
    story.supervisor.on_path([GOAL])
    assert story.again().v == pytest.approx(1.3 * math.tanh(3.0))


ROUTE = [Pose(2.0, 0.0, 0.0), Pose(2.0, 3.0, 1.0), Pose(-1.0, 1.0, -2.0)]


def progress(story):
    supervisor = story.supervisor
    return supervisor.waypoint, supervisor.waypoints, supervisor.goal


def test_a_path_is_driven_in_order_and_the_last_is_held():
    story = Story(controller=QUICK)
    story.supervisor.on_path(list(ROUTE))
    assert story.state == WAITING
    for number, goal in enumerate(ROUTE, 1):
        assert progress(story) == (number, 3, goal)
        story.pose(goal)
        assert progress(story) == (number, 3, goal)
        story.pose(goal)
        # Reached: the next one is due from the next pose on, but the last stays.
        assert story.supervisor.goals_reached == number
        assert progress(story) == (min(number + 1, 3), 3, ROUTE[min(number, 2)])
        assert story.state == (DRIVING if number < 3 else REACHED)
    for _ in range(3):
        story.pose(ROUTE[-1])
        assert story.state == REACHED
    assert story.supervisor.goals_reached == 3
    assert story.pose(Pose(-4.0, 1.0, -2.0)) is not None, "held"


def test_each_waypoint_is_driven_to_as_a_goal_of_its_own():
    story, twin = Story(controller=QUICK), Story(controller=QUICK)
    story.supervisor.on_path([ROUTE[0], ROUTE[1]])
    twin.supervisor.on_goal(ROUTE[0])
    poses = [Pose(-1.0, 0.0, 0.0), Pose(1.0, 0.2, 0.1), ROUTE[0], ROUTE[0]]
    for pose in poses:
        assert story.pose(pose) == twin.pose(pose)
    twin.supervisor.on_goal(ROUTE[1])
    assert story.supervisor.memory == twin.supervisor.memory
    for pose in (ROUTE[0], Pose(2.0, 1.0, 1.0), ROUTE[1]):
        assert story.pose(pose) == twin.pose(pose)
        assert story.supervisor.report == twin.supervisor.report


def test_waypoints_are_passed_at_the_radius_but_the_last_is_not():
    story = Story(controller=QUICK, waypoint_radius=0.5)
    story.supervisor.on_path(list(ROUTE))
    story.pose(Pose(1.49, 0.0, 0.0))
    assert story.supervisor.waypoint == 1
    # Just inside, at full speed, with any heading: passed, but not reached.
    command = story.pose(Pose(1.51, 0.0, 2.0))
    assert story.supervisor.waypoint == 2
    assert abs(command.v) > 0.1
    assert story.supervisor.goals_reached == 0
    story.pose(Pose(2.0, 2.6, 0.0))
    assert progress(story) == (3, 3, ROUTE[2])
    story.pose(Pose(-1.0, 1.1, 0.0))
    assert (story.state, story.supervisor.waypoint) == (DRIVING, 3)
    for _ in range(2):
        story.pose(ROUTE[2])
    assert story.state == REACHED
    assert story.supervisor.goals_reached == 1


def test_one_waypoint_for_each_pose_however_near_they_are():
    story = Story(waypoint_radius=10.0)
    story.supervisor.on_path(list(ROUTE))
    waypoints = [(story.pose(AWAY), story.supervisor.waypoint)[1] for _ in range(5)]
    assert waypoints == [2, 3, 3, 3, 3]


def test_a_pose_sent_again_when_a_waypoint_was_passed_has_the_same_answer_and_passes_no_other():
    story = Story(waypoint_radius=10.0)
    story.supervisor.on_path(list(ROUTE))
    answer = story.pose(AWAY)
    memory = story.supervisor.memory
    for _ in range(3):
        assert story.again(AWAY) == answer
        assert story.supervisor.waypoint == 2
        assert story.supervisor.memory == memory


@pytest.mark.parametrize("size", [1, 2])
def test_the_newest_goal_or_path_wins(size):
    story = Story(controller=QUICK)
    story.pose(AWAY)
    story.supervisor.on_path(list(ROUTE))
    story.pose(AWAY)
    story.supervisor.on_goal(GOAL)
    assert progress(story) == (0, 0, GOAL)
    reach(story)
    story.pose(AT_GOAL)
    assert progress(story) == (0, 0, GOAL), "what was left of the path is forgotten"
    story.supervisor.on_path(ROUTE[:size])
    assert progress(story) == (1, size, ROUTE[0])
    story.supervisor.on_path(ROUTE[1:])
    assert progress(story) == (1, 2, ROUTE[1])
    assert story.supervisor.memory.reached is False
    story.pose(AWAY)
    assert story.state == DRIVING


def test_a_path_of_one_is_a_goal():
    story = Story(controller=QUICK)
    story.supervisor.on_path([GOAL])
    reach(story)
    assert progress(story) == (1, 1, GOAL)


def test_a_path_can_be_given_up_and_nothing_of_it_comes_back():
    story = Story(controller=QUICK)
    story.supervisor.on_path(list(ROUTE))
    for _ in range(2):
        story.pose(ROUTE[0])
    assert story.supervisor.waypoint == 2
    assert story.supervisor.on_cancel() == ZERO
    assert (story.state, progress(story)) == (IDLE, (0, 0, None))
    assert [story.pose(AWAY) for _ in range(6)] == [ZERO] * 4 + [None] * 2
    story.supervisor.on_goal(GOAL)
    reach(story)
    assert progress(story) == (0, 0, GOAL)


def test_a_path_that_is_not_held_goes_idle_only_at_its_end():
    story = Story(controller=QUICK, hold_goal=False)
    story.supervisor.on_path(list(ROUTE[:2]))
    for _ in range(2):
        story.pose(ROUTE[0])
    assert (story.state, story.supervisor.goal) == (DRIVING, ROUTE[1])
    for _ in range(2):
        story.pose(ROUTE[1])
    assert (story.state, story.supervisor.goal) == (REACHED, None)
    assert story.supervisor.goals_reached == 2


def test_the_list_of_a_path_stays_the_callers():
    story = Story(controller=QUICK)
    route = list(ROUTE)
    story.supervisor.on_path(route)
    for goal in ROUTE * 2:
        story.pose(goal)
        story.pose(goal)
    assert route == ROUTE


def test_the_motion_goes_on_from_waypoint_to_waypoint():
    story = Story(controller=SLOW_DOWN, waypoint_radius=1.0)
    story.supervisor.on_path([Pose(-50.0, 0.0, 0.0), Pose(50.0, 0.0, 0.0)])
    speeds = [story.pose(Pose(-52.0 + 0.3 * number, 0.0, 0.0)).v for number in range(8)]
    assert story.supervisor.waypoint == 2
    assert speeds == pytest.approx([0.1 * number for number in range(8)], abs=1e-9)


def test_silence_on_the_way_keeps_the_path():
    story = Story(controller=QUICK)
    story.supervisor.on_path(list(ROUTE))
    story.pose(AWAY)
    assert story.tick(1.0) == ZERO
    assert (story.state, progress(story)) == (STALE, (1, 3, ROUTE[0]))
    for _ in range(2):
        story.pose(ROUTE[0])
    assert progress(story) == (2, 3, ROUTE[1])


GIVEN_UP = "goal not reached"


def test_a_goal_that_takes_too_long_is_given_up_with_the_reason_and_braking():
    config = PAPER._replace(data_sheet=PAPER_DATA_SHEET._replace(a_max=1.0))
    story = Story(controller=config, goal_timeout=2.0)
    story.supervisor.on_goal(GOAL)
    far = Pose(-50.0, 0.0, 0.0)
    for _ in range(20):
        story.pose(far)
        assert story.state == DRIVING
        assert story.supervisor.reason == ""
    last = story.pose(far)
    assert story.state == GIVEN_UP
    assert story.supervisor.reason == "not reached within goal_timeout = 2 s"
    assert story.supervisor.goal is None
    # It comes to rest within its limits, and then is silent.
    speeds = [story.pose(far).v for _ in range(15)]
    assert last.v == pytest.approx(1.3)
    assert speeds == pytest.approx([max(1.3 - 0.1 * step, 0.0) for step in range(1, 16)], abs=1e-12)
    assert story.state == GIVEN_UP
    # The next goal has its own time.
    story.supervisor.on_goal(GOAL)
    story.pose(far, after=30.0)
    assert (story.state, story.supervisor.reason) == (DRIVING, "")


def test_no_timeout_by_default_and_none_once_reached():
    story = Story(controller=QUICK)
    story.supervisor.on_goal(GOAL)
    for _ in range(200):
        story.pose(after=0.9)
    assert story.state == DRIVING
    story = Story(controller=QUICK, goal_timeout=1.0)
    story.supervisor.on_goal(GOAL)
    for _ in range(40):
        story.pose(AT_GOAL)
    assert story.state == REACHED


@pytest.mark.parametrize("most", [0, 1, 3])
def test_a_robot_that_keeps_leaving_omega_l_gives_up(most):
    story = Story(controller=QUICK, max_departures=most)
    story.supervisor.on_goal(GOAL)
    departures = 0
    for number in range(20):
        # In turn inside 0.5 m and beyond 0.6 m, too fast or too far to be reached.
        story.pose(Pose(-0.45 if number % 2 == 0 else -0.8, 0.0, 0.5))
        departures += number % 2
        if most and departures == most:
            assert story.state == GIVEN_UP
            assert story.supervisor.reason == f"hunting: left Omega_L {most} times (max_departures = {most})"
            return
        assert story.state == DRIVING
    assert most == 0


def test_a_command_beyond_lowered_limits_is_reported_until_the_limits_hold():
    story = Story(controller=SLOW_DOWN)
    story.supervisor.on_goal(GOAL)
    for _ in range(10):
        story.pose()
    assert not story.supervisor.is_beyond_limits
    lowered = SLOW_DOWN._replace(data_sheet=SLOW_DOWN.data_sheet._replace(v_max=0.65))
    story.supervisor.config = SupervisorConfig(controller=lowered)
    reports = []
    for _ in range(5):
        command = story.pose()
        reports.append((round(command.v, 3), story.supervisor.is_beyond_limits))
    assert reports == [(0.8, True), (0.7, True), (0.65, False), (0.65, False), (0.65, False)]
