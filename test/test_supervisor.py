"""Goals, silence and coming to rest: the supervisor's states, by stories with made-up time."""

import math

import pytest

from diffbot_control.controller import ControllerConfig, ControllerMemory, step
from diffbot_control.geometry import Pose
from diffbot_control.goal import GoalTolerance
from diffbot_control.limits import Limits
from diffbot_control.supervisor import (
    DRIVING,
    IDLE,
    REACHED,
    STALE,
    STATES,
    WAITING,
    Supervisor,
    SupervisorConfig,
)

ZERO = (0.0, 0.0)
GOAL = Pose(0.0, 0.0, 0.0)
AWAY = Pose(-3.0, 0.0, 0.0)
AT_GOAL = Pose(-0.01, 0.0, 0.0)
QUICK = ControllerConfig(tolerance=GoalTolerance(settling_steps=2))
SLOW_DOWN = ControllerConfig(limits=Limits(a_max=1.0))


class Story:
    """A supervisor with a clock; poses are stamped with it."""

    def __init__(self, **options):
        self.supervisor = Supervisor(SupervisorConfig(**options))
        self.now = 100.0

    def pose(self, pose=AWAY, after=0.1):
        self.now += after
        return self.supervisor.on_pose(round(self.now * 1e9), self.now, pose)

    def tick(self, after=0.1):
        self.now += after
        return self.supervisor.on_tick(self.now)

    @property
    def state(self):
        return self.supervisor.state


def test_the_documented_states():
    assert STATES == ("idle", "waiting for pose", "driving", "goal reached", "stale pose")


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
    assert command == pytest.approx((1.3 * math.tanh(3.0), 0.0))


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
    story = Story(controller=ControllerConfig(limits=Limits(a_max=0.1)))
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
    tolerance = GoalTolerance(settling_steps=2, stateful=False)
    story = Story(controller=ControllerConfig(tolerance=tolerance))
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
    heard = story.now
    assert story.supervisor.on_tick(heard + timeout - 1e-6) is None
    assert story.state == DRIVING
    assert story.supervisor.on_tick(heard + timeout + 1e-6) == ZERO
    assert story.state == STALE
    # It goes on saying so: one lost message must not matter.
    assert [story.supervisor.on_tick(heard + timeout + n) for n in range(1, 9)] == [ZERO] * 8
    assert (story.supervisor.memory.v, story.supervisor.memory.omega) == ZERO
    story.now = heard + 20.0
    assert story.pose().v == pytest.approx(1.3 * math.tanh(3.0))
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
    assert story.supervisor.memory.v == pytest.approx(0.3)
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
    story = Story(controller=QUICK, hold_goal=hold, publish_when_idle=when_idle)
    story.supervisor.on_goal(GOAL)
    seen, number = {story.state}, 7
    actions = (
        lambda: story.pose(AT_GOAL),
        lambda: story.pose(AWAY),
        lambda: story.tick(0.1),
        lambda: story.tick(1.0),
        lambda: story.supervisor.on_goal(GOAL),
        story.supervisor.on_cancel,
    )
    for _ in range(3000):
        number = (1103515245 * number + 12345) % 2**31
        command = actions[(number >> 16) % 6]()
        seen.add(story.state)
        assert command is None or all(math.isfinite(value) for value in command)
        if story.supervisor.goal is None:
            assert command in (None, ZERO) or story.state == REACHED
        else:
            assert story.state in (WAITING, DRIVING, REACHED, STALE)
    assert seen == set(STATES)
