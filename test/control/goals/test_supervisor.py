"""The supervisor's states in simulated sequences of goals, poses and silence."""

import math

import pytest

from diffbot_control.goals import Supervisor, SupervisorConfig
from diffbot_control.goals.record import (
    NOT_REACHED,
    POSE_LOST,
    REFUSED,
    REPLACED,
    GoalBook,
    GoalRequest,
    goal_id,
)
from diffbot_control.goals.states import AT_GOAL as REACHED
from diffbot_control.goals.states import DRIVING, IDLE, NOT_AT_GOAL, STALE, UNCERTAIN, WAITING
from diffbot_control.goals.timing import time_remaining
from diffbot_control.law import PRESETS, PaperConfig, PaperLaw, SwitchingConfig, SwitchingLaw
from diffbot_core.data_sheet import PAPER_DATA_SHEET, DataSheet
from diffbot_core.errors import BadMessageError
from diffbot_core.geometry import Pose
from diffbot_core.kinematics import Twist
from diffbot_core.uncertainty import CERTAIN, Uncertainty

ZERO = (0.0, 0.0)
GOAL = Pose(0.0, 0.0, 0.0)
AWAY = Pose(-3.0, 0.0, 0.0)
AT_GOAL = Pose(-0.01, 0.0, 0.0)
FAR = Pose(-50.0, 0.0, 0.0)
PAPER = PRESETS["paper"].config
QUICK = PAPER._replace(tolerance=PAPER.tolerance._replace(settling_steps=2))
SLOW_DOWN = PAPER._replace(data_sheet=PAPER_DATA_SHEET._replace(a_max=1.0))
UNSURE = Uncertainty(0.3, 0.01)
"""Too uncertain for the tolerance of 0.4 m of the paper's preset."""


class Story:
    """A supervisor with a clock that stamps the poses."""

    def __init__(self, **options):
        config = SupervisorConfig(**options)
        law = PaperLaw if isinstance(config.controller, PaperConfig) else SwitchingLaw
        self.supervisor = Supervisor(config, law)
        self.now = 100.0

    def pose(self, pose=AWAY, after=0.1, uncertainty=CERTAIN):
        self.now += after
        return self.supervisor.on_pose(round(self.now * 1e9), self.now, pose, uncertainty)

    def tick(self, after=0.1):
        self.now += after
        return self.supervisor.on_tick(self.now)

    def wait(self, seconds):
        for _ in range(round(10 * seconds)):
            self.tick()

    @property
    def state(self):
        return self.supervisor.status


def driving(**options):
    """Return a story in which the goal has been accepted."""
    story = Story(**options)
    story.supervisor.on_goal(GOAL)
    return story


def test_a_gap_between_stamps_counts_for_a_second_and_time_backwards_for_none():
    story = driving(controller=SLOW_DOWN)
    steps = [(FAR, 0.1), (FAR, 0.1), (FAR, 0.3), (FAR, 0.0), (FAR, 0.25), (FAR, 30.0), (Pose(50.0, 0.0, 0.0), 30.0)]
    commands = [story.pose(pose, after) for pose, after in steps]
    assert commands.pop(3) is None, "a pose whose stamp stands still is not answered"
    assert [command.v for command in commands] == pytest.approx([0.0, 0.1, 0.4, 0.65, 1.3, 0.3])
    assert story.pose(Pose(50.0, 0.0, 0.0), -20.0) is None
    assert story.pose(Pose(50.0, 0.0, 0.0), 0.1).v == pytest.approx(0.2)


def reach(story):
    """Drive a story with settling_steps = 2 to its goal."""
    story.pose(AT_GOAL)
    assert story.state == DRIVING
    story.pose(AT_GOAL)
    assert story.state == REACHED


def test_a_held_goal_is_still_controlled_and_counts_once():
    story = driving(controller=QUICK)
    reach(story)
    assert story.pose(Pose(-0.7, 0.0, 0.0)).v == pytest.approx(1.3 * math.tanh(0.7))
    assert story.state == DRIVING
    assert story.tick(1.0) == ZERO
    assert story.state == STALE
    for _ in range(2):
        story.pose(AT_GOAL)
    assert story.state == REACHED
    assert story.supervisor.goals_reached == 1


def test_a_robot_found_far_from_a_held_goal_never_drives_back():
    tolerance = QUICK.tolerance._replace(xy_goal_tolerance=0.1)
    options = {"controller": QUICK._replace(tolerance=tolerance), "pose_lost_timeout": 0.0}
    story = driving(hold_distance=0.3, **options)
    reach(story)
    assert story.pose(Pose(-0.29, 0.0, 0.0)).v > 0.2
    assert story.state == DRIVING
    assert story.pose(Pose(-0.31, 0.0, 0.0)) == ZERO
    assert (story.state, story.supervisor.goal) == (IDLE, None)
    assert story.supervisor.reason == "the robot was found 0.31 m from the held goal: hold_distance = 0.3 m"
    # The same after an hour without poses.
    story = driving(**options)
    reach(story)
    story.tick(3600.0)
    assert story.state == STALE
    assert story.pose(Pose(-8.5, 0.0, 0.0), after=0.0) == ZERO
    assert story.state == IDLE


def test_a_held_goal_expires_with_the_pose():
    story = driving(controller=QUICK, pose_lost_timeout=5.0)
    reach(story)
    story.wait(4.9)
    assert (story.state, story.supervisor.goal) == (STALE, GOAL)
    story.wait(0.2)
    assert (story.state, story.supervisor.goal) == (IDLE, None)
    assert "no pose for pose_lost_timeout = 5 s" in story.supervisor.reason
    assert story.supervisor.goals.ended[-1].end == "reached", "its answer stays"


def test_cancelling_a_path_stops_at_once_and_sends_five_zeros():
    story = Story(controller=QUICK)
    story.supervisor.on_path(list(ROUTE))
    for _ in range(2):
        story.pose(ROUTE[0])
    assert story.supervisor.waypoint == 2
    assert story.supervisor.on_cancel() == ZERO
    assert (story.state, progress(story), story.supervisor.report) == (IDLE, (0, 0, None), None)
    assert [story.pose() for _ in range(6)] == [ZERO] * 4 + [None] * 2
    assert story.supervisor.on_cancel() is None


FOLLOWING = {
    "at rest": lambda story: [story.pose() for _ in range(5)],
    "no pose": lambda story: story.tick(1.0),
    "newer goal": lambda story: story.supervisor.on_goal(GOAL),
    "hopeless": lambda story: story.supervisor.give_up("no progress"),
    "fault": lambda story: story.supervisor.on_fault("broken"),
    "stop": lambda story: story.supervisor.on_stop("by the end of the node"),
}


@pytest.mark.parametrize("event", FOLLOWING)
def test_a_cancelled_goal_ends_with_who_cancelled_it_whatever_follows(event):
    story = driving(controller=SLOW_DOWN)
    for _ in range(5):
        story.pose()
    assert story.supervisor.on_cancel("by the operator") != ZERO
    assert story.supervisor.goals.present.is_cancelling
    answer = FOLLOWING[event](story)
    assert event != "no pose" or answer == ZERO
    assert story.supervisor.goals.ended[-1].text == "cancelled: by the operator"


@pytest.mark.parametrize("uncertainty", [UNSURE, Uncertainty(0.01, 0.06)])
def test_a_tolerance_below_the_uncertainty_is_reported_at_rest_only(uncertainty):
    story = driving(controller=QUICK)
    for pose in (AWAY, Pose(-0.3, 0.0, 0.0), Pose(0.0, 0.0, 0.09)):
        story.pose(pose, uncertainty=uncertainty)
        assert story.state == DRIVING, "far away, near and moving, near and turning"
    for _ in range(5):
        story.pose(AT_GOAL, uncertainty=uncertainty)
        assert story.state == UNCERTAIN
    # With a better estimate the goal is reached after two poses, and stays reached.
    reach(story)
    story.pose(AT_GOAL, uncertainty=uncertainty)
    assert (story.state, story.supervisor.goals_reached) == (REACHED, 1)


@pytest.mark.parametrize("before", ["nothing", "a long silence", "a pose", "a clock set back"])
def test_a_goal_without_poses_ends_after_pose_lost_timeout(before):
    story = Story(pose_lost_timeout=2.0)
    if before == "a long silence":
        story.pose()
        story.tick(10.0)
    story.supervisor.on_goal(GOAL)
    if before in ("a pose", "a clock set back"):
        story.pose()
    if before == "a clock set back":
        story.now = 0.0
    story.wait(1.8)
    assert not story.supervisor.goals.ended
    story.wait(0.5)
    (record,) = story.supervisor.goals.ended
    assert (record.end, record.reason) == (POSE_LOST, "no pose for pose_lost_timeout = 2 s")
    assert (story.state, story.supervisor.goal) == (NOT_AT_GOAL, None)


def test_poses_whose_stamp_does_not_advance_stop_the_robot_and_lose_the_goal():
    story = driving(controller=PAPER, pose_timeout=0.52, pose_lost_timeout=5.0)
    command = story.pose()
    stamp, memory = round(story.now * 1e9), story.supervisor.memory
    for number in range(1, 100):
        story.now += 0.05
        answer = story.supervisor.on_pose(stamp, story.now, AWAY._replace(x=-3.0 + 1e-3 * number))
        is_overdue = number > 10
        assert (answer, story.tick(0.0)) == ((ZERO, ZERO) if is_overdue else (None, None))
        assert story.state == (STALE if is_overdue else DRIVING)
        assert is_overdue or story.supervisor.memory == memory, "no step"
    story.tick(0.1)
    assert (story.state, story.supervisor.goals.ended[-1].end) == (NOT_AT_GOAL, POSE_LOST)
    # A later stamp counts again.
    story.supervisor.on_goal(GOAL)
    assert story.pose() == command
    assert story.state == DRIVING


def test_a_correction_changes_neither_memory_nor_records_and_ends_with_the_goal():
    story = Story(controller=SLOW_DOWN)
    story.supervisor.on_path(list(ROUTE))
    for _ in range(5):
        story.pose()
    memory, accepted = story.supervisor.memory, story.supervisor.accepted
    story.supervisor.on_goal_update(Pose(-1.2, 1.1, -1.8))
    assert story.supervisor.goals_ahead == [*ROUTE[:2], Pose(-1.2, 1.1, -1.8)]
    assert (story.supervisor.memory, story.supervisor.accepted) == (memory, accepted)
    assert not story.supervisor.goals.ended
    # The next correction is compared with the corrected goal.
    story.supervisor.on_goal_update(Pose(-1.6, 1.1, -1.8))
    assert story.supervisor.updates == 2
    story = driving(controller=QUICK)
    reach(story)
    story.supervisor.on_goal_update(Pose(0.1, 0.0, 0.0))
    assert (story.supervisor.goal, story.supervisor.updates) == (GOAL, 0), "a reached goal is not corrected"


def test_a_correction_that_jumps_is_refused_and_changes_nothing():
    supervisor = driving().supervisor
    for goal, text in (
        (Pose(0.0, 0.51, 0.0), "far from the goal: 0.51 m, goal_update_distance = 0.5 m"),
        (Pose(0.1, 0.0, 2.0 * math.pi - 0.51), "heading differs from the goal: 0.51 rad, at most 0.5 rad"),
    ):
        with pytest.raises(BadMessageError, match=text):
            supervisor.on_goal_update(goal)
        assert (supervisor.goal, supervisor.updates) == (GOAL, 0)
    supervisor.on_goal_update(Pose(0.0, 0.49, 2.0 * math.pi + 0.49))
    assert supervisor.updates == 1


ROUTE = [Pose(2.0, 0.0, 0.0), Pose(2.0, 3.0, 1.0), Pose(-1.0, 1.0, -2.0)]


def progress(story):
    supervisor = story.supervisor
    return supervisor.waypoint, supervisor.waypoints, supervisor.goal


def test_a_path_is_driven_goal_by_goal_and_the_last_is_held():
    story, route = Story(controller=QUICK, waypoint_radius=0.0), list(ROUTE)
    story.supervisor.on_path(route)
    assert story.state == WAITING
    for number, goal in enumerate(ROUTE, 1):
        twin = Story(controller=QUICK)
        twin.supervisor.on_goal(goal)
        for pose in (AWAY, Pose(1.0, 1.0, 0.5), goal):
            assert progress(story) == (number, 3, goal)
            assert story.pose(pose) == twin.pose(pose), "as to a goal of its own"
        assert story.tick(1.0) == ZERO
        assert (story.state, progress(story)) == (STALE, (number, 3, goal)), "silence keeps the path"
        for _ in range(2):
            story.pose(goal)
        # The next goal begins with the next pose; the last goal is held.
        assert story.supervisor.goals_reached == number
        assert progress(story) == (min(number + 1, 3), 3, ROUTE[min(number, 2)])
        assert story.state == (DRIVING if number < 3 else REACHED)
    assert story.pose(Pose(-1.3, 1.0, -2.0)) is not None, "held"
    assert (story.state, story.supervisor.goals_reached) == (REACHED, 3)
    assert route == ROUTE, "the list stays the caller's"


def test_waypoints_within_the_radius_are_passed_before_the_step_and_the_last_one_is_reached():
    story = Story(controller=QUICK, waypoint_radius=0.4)
    # Several waypoints at once, but only consecutive ones, and never the last one.
    story.supervisor.on_path([Pose(0.1 * i, 0.0, 0.0) for i in range(10)])
    for x, waypoint in ((-0.41, 1), (0.0, 5), (0.9, 5), (0.7, 10)):
        assert story.pose(Pose(x, 0.0, 0.0)).v != 0.0, "without a stop"
        goal = 0.1 * (waypoint - 1)
        assert progress(story)[:2] == (waypoint, 10)
        assert story.supervisor.goal.x == pytest.approx(goal)
        assert story.supervisor.report.rho == pytest.approx(abs(goal - x)), "the step drives to the new goal"
    for _ in range(2):
        assert story.state == DRIVING
        story.pose(Pose(0.9, 0.0, 0.0))
    assert (story.state, story.supervisor.goals_reached) == (REACHED, 1)


def test_a_path_that_is_planned_again_to_the_same_goal_does_not_count_as_progress():
    def time_to_end(last_poses):
        story = Story(pose_lost_timeout=0.0)
        for second in range(60):
            start = [Pose(AWAY.x + 0.05 * i, 0.0, 0.0) for i in range(20)]
            story.supervisor.on_path([*start, last_poses[second % len(last_poses)]])
            for _ in range(10):
                story.pose(AWAY)
                if story.state == NOT_AT_GOAL:
                    return second
        return None

    assert time_to_end([GOAL]) == pytest.approx(30, abs=1)
    assert time_to_end([GOAL, Pose(0.5, 0.0, 0.0)]) is None, "another goal begins anew"


def test_a_blocked_robot_is_given_up_even_if_the_planner_changes_between_two_routes():
    story = Story(pose_lost_timeout=0.0)
    for second in range(60):
        start = [Pose(AWAY.x, 0.05 * i, 0.0) for i in range(20)]
        story.supervisor.on_path([*start, Pose(-1.5, (1.0, 3.0)[second % 2], 0.0), GOAL])
        for _ in range(10):
            story.pose(AWAY)
        if story.state == NOT_AT_GOAL:
            break
    assert second == pytest.approx(30, abs=2)


def test_a_path_that_is_planned_again_without_poses_ends_after_pose_lost_timeout():
    story = Story(pose_lost_timeout=5.0)
    story.pose()
    for _ in range(6):
        story.supervisor.on_path([AWAY, GOAL])
        story.wait(1.0)
    assert POSE_LOST in [record.end for record in story.supervisor.goals.ended]


@pytest.mark.parametrize("hold_goal", [False, True])
def test_a_goal_that_is_reached_with_a_doubtful_pose_names_the_fault(hold_goal):
    story = driving(hold_goal=hold_goal)
    story.supervisor.pose_fault = "/ekf: global_pose is stamped 0.50 s behind odom"
    for _ in range(20):
        story.pose(GOAL)
    record = story.supervisor.goals.ended[-1]
    assert record.text == "reached: /ekf: global_pose is stamped 0.50 s behind odom"
    assert story.supervisor.reason == ""


def test_a_goal_that_takes_too_long_is_given_up_with_the_reason_what_hinders_the_robot_and_braking():
    story = driving(controller=SLOW_DOWN, goal_timeout=2.0)
    story.supervisor.problem = "no base subscribes to /cmd_vel"
    for _ in range(20):
        story.pose(FAR)
        assert (story.state, story.supervisor.reason) == (DRIVING, "")
    assert story.pose(FAR).v == pytest.approx(1.2)
    assert (story.state, story.supervisor.goal) == (NOT_AT_GOAL, None)
    assert story.supervisor.reason == "not reached within goal_timeout = 2 s; no base subscribes to /cmd_vel"
    speeds = [story.pose(FAR).v for _ in range(13)]
    assert speeds == pytest.approx([1.2 - 0.1 * step for step in range(1, 13)] + [0.0], abs=1e-12)
    # The next goal has its own time.
    story.supervisor.on_goal(GOAL)
    story.pose(FAR, after=30.0)
    assert (story.state, story.supervisor.reason) == (DRIVING, "")


def test_a_command_beyond_lowered_limits_is_reported_until_the_limits_hold():
    story = driving(controller=SLOW_DOWN)
    for _ in range(10):
        story.pose()
    assert not story.supervisor.is_beyond_limits
    lowered = SLOW_DOWN._replace(data_sheet=SLOW_DOWN.data_sheet._replace(v_max=0.65))
    story.supervisor.config = SupervisorConfig(controller=lowered)
    reports = [(round(story.pose().v, 3), story.supervisor.is_beyond_limits) for _ in range(4)]
    assert reports == [(0.8, True), (0.7, True), (0.65, False), (0.65, False)]


def test_a_goal_has_a_finite_time_from_its_acceptance_on_that_grows_with_the_route():
    near, far, blind = Story(), Story(), Story()
    for story, goal in ((near, Pose(1.0, 0.0, 0.0)), (far, Pose(131.0, 0.0, 0.0))):
        story.pose(Pose(0.0, 0.0, 0.0))
        story.supervisor.on_goal(goal)
    # 130 m more at 1.3 m/s, four times.
    assert far.supervisor.timeout - near.supervisor.timeout == pytest.approx(400.0)
    assert 120.0 + 4.0 / 1.3 < near.supervisor.timeout < 150.0
    # The distance to the first goal is added with the first pose.
    blind.supervisor.on_goal(Pose(131.0, 0.0, 0.0))
    assert 120.0 <= blind.supervisor.timeout <= near.supervisor.timeout
    blind.pose(Pose(0.0, 0.0, 0.0))
    assert blind.supervisor.timeout == pytest.approx(far.supervisor.timeout)
    # Limits that were lowered since the last step count for the next goal.
    config = near.supervisor.config
    slow = config.controller.data_sheet._replace(v_max=0.1)
    near.supervisor.config = config._replace(controller=config.controller._replace(data_sheet=slow))
    near.supervisor.on_goal(Pose(131.0, 0.0, 0.0))
    assert near.supervisor.timeout > 131.0 / 0.1


def test_a_robot_without_a_limit_of_the_turn_rate_is_given_up_too():
    sheet = PAPER_DATA_SHEET._replace(omega_dot_max=3.0)
    story = Story(controller=PAPER._replace(data_sheet=sheet))
    story.pose(AWAY)
    story.supervisor.on_goal(GOAL)
    assert 120.0 < story.supervisor.timeout < 200.0
    assert 30.0 <= seconds_until_given_up(story, lambda _: AWAY) <= 60.0


def test_a_new_goal_after_a_rest_is_not_approached_as_if_the_robot_still_moved():
    story = Story(controller=SwitchingConfig(data_sheet=DataSheet(command_latency=0.5)))
    story.supervisor.on_goal(Pose(9.0, 0.0, 0.0))
    for number in range(20):
        assert story.pose(Pose(0.13 * number, 0.0, 0.0)).v == pytest.approx(1.3)
    story.supervisor.on_cancel()
    for _ in range(20):
        story.pose(Pose(3.0, 0.0, 0.0))
    story.supervisor.on_goal(Pose(3.3, 0.0, 0.0))
    assert story.pose(Pose(3.0, 0.0, 0.0)).v > 0.0
    assert story.supervisor.report.rho == pytest.approx(0.3)


def test_a_book_knows_its_goals_by_their_ids_and_the_newest_accepted_one():
    book = GoalBook()

    def accept(numbers):
        for number in numbers:
            book.close(REPLACED, "", 1.0)
            book.accept(GoalRequest(str(number)))

    accept(range(40))
    book.refuse(GoalRequest("bad"), REFUSED, "why")
    assert book.newest.request.id == "39"
    assert [one.request.id for one in book.ended] == [*map(str, range(8, 39)), "bad"]
    assert [book.knows(one) for one in ("0", "39", "bad", "", "40")] == [True, True, True, False, False]
    accept(range(40, 1100))
    assert not book.knows("0"), "a message that is repeated so late is a new goal"


def test_the_id_of_a_goal_is_the_uuid_of_its_frame_and_stamp():
    # python3 -c "import uuid; print(uuid.uuid5(uuid.NAMESPACE_OID, 'map 1700000000000000001').hex)"
    assert goal_id("map", 1700000000000000001) == "9168e7ebdda954468b4542eeab2a1e75"


def test_time_remaining_begins_with_the_limit_and_goes_on_with_the_mean_speed():
    assert time_remaining(4.0, 4.0, 0.0, 0.5) == pytest.approx(8.0)
    assert time_remaining(3.9, 4.0, 10.0, 0.5) == pytest.approx(7.8), "too early for a mean"
    assert time_remaining(1.0, 4.0, 6.0, 0.5) == pytest.approx(2.0), "3 m in 6 s"
    assert time_remaining(4.0, 4.0, 0.0, math.inf) == 0.0


def seconds_until_given_up(story, pose_at, uncertainty=CERTAIN):
    began = story.now
    while story.state != NOT_AT_GOAL and story.now < began + 1000.0:
        story.pose(pose_at(story.now - began), uncertainty=uncertainty)
    return story.now - began


def test_a_blocked_robot_ends_with_no_progress_and_a_slow_one_drives_on():
    story = driving()
    # Blocked, with an estimate that wavers.
    assert 30.0 <= seconds_until_given_up(story, lambda t: Pose(-3.0 + 0.03 * math.sin(t), 0.0, 0.0)) <= 45.0
    assert story.supervisor.reason.startswith("no progress for 3")
    story = Story()
    story.supervisor.on_goal(Pose(10.0, 0.0, 0.0))
    # 0.02 m/s over 10 m is progress, so only the derived timeout ends the goal.
    timeout = story.supervisor.timeout
    seconds_until_given_up(story, lambda t: Pose(0.02 * t, 0.0, 0.0))
    assert story.supervisor.reason.startswith("not reached within goal_timeout")
    assert timeout > 120.0


def test_a_goal_that_is_too_narrow_for_the_estimate_ends_after_a_minute_with_the_smallest_tolerance():
    story = driving(controller=QUICK, goal_timeout=0.0)
    assert seconds_until_given_up(story, lambda _: AT_GOAL, UNSURE) == pytest.approx(60.0, abs=1.0)
    # 99 % of a Rayleigh and of a normal distribution: 3.0349 * 0.3 m and 2.5758 * 0.01 rad.
    smallest = "the smallest possible tolerances are 0.91 m and 0.0258 rad"
    assert story.supervisor.reason == f"the estimate is too uncertain: {smallest}"
    # With 0.4 times the uncertainty it is reached.
    story = driving(controller=QUICK, uncertainty_scale=0.4)
    for _ in range(2):
        story.pose(AT_GOAL, uncertainty=UNSURE)
    assert story.state == REACHED


@pytest.mark.parametrize(
    ("command", "seconds", "reason"),
    [
        (Twist(0.0, 0.0), 60.0, "at rest for 60 s without being within the tolerances, 0.01 m to go"),
        (Twist(0.2, 2.0), 120.0, "no progress for 120 s, 0.01 m to go"),
    ],
)
def test_a_law_that_never_reaches_a_near_goal_is_given_up_even_without_a_timeout(command, seconds, reason):
    class Never(PaperLaw):
        @staticmethod
        def step(memory, observation, goal, config):
            after, _, report = PaperLaw.step(memory, observation, goal, config)
            return after._replace(reached=False), command, report

    story = Story(goal_timeout=0.0)
    story.supervisor = Supervisor(SupervisorConfig(controller=QUICK, goal_timeout=0.0), Never)
    story.supervisor.on_goal(GOAL)
    assert seconds_until_given_up(story, lambda _: AT_GOAL) == pytest.approx(seconds, abs=1.0)
    assert story.supervisor.reason == reason


def test_a_controller_that_was_suspended_ends_its_goal():
    story = driving()
    steady = 7.0
    for passed in (0.1, 0.1, 1.9, 0.1):
        story.now, steady = story.now + passed, steady + passed
        story.supervisor.on_pose(round(story.now * 1e9), story.now, AWAY, CERTAIN, steady)
    assert story.state == DRIVING
    story.now, steady = story.now + 0.1, steady + 2.3  # the clock may have been set meanwhile
    story.supervisor.on_tick(story.now, steady)
    (record,) = story.supervisor.goals.ended
    assert (record.end, record.reason) == (NOT_REACHED, "the controller was suspended for 2.3 s")


REGULAR = [(0.05, 0.05)] * 5


@pytest.mark.parametrize(
    ("arrivals", "expected"),
    [
        (REGULAR, [0.0, 0.05, 0.1, 0.15, 0.2]),
        # Stamps 5 s ahead: 0.05 s have passed, and 0.05 s of jitter are allowed once.
        ([*REGULAR, (5.0, 0.05), (5.0, 0.05)], [0.3, 0.35]),
        # A hiccup of 0.4 s whose eight poses come at once: 0.05 s by the stamp, 0.05 s of jitter, and 7 ms.
        ([*REGULAR, (0.05, 0.4), *[(0.05, 0.001)] * 7], [0.307]),
    ],
)
def test_the_limits_of_acceleration_use_only_the_time_since_the_last_command(arrivals, expected):
    """An arrival is the time since the last pose, by its stamp and true; the robot has 1 m/s^2."""
    supervisor, stamp, steady, speeds = Supervisor(SupervisorConfig(controller=SLOW_DOWN), PaperLaw), 100.0, 7.0, []
    supervisor.on_goal(GOAL)
    for by_stamp, passed in arrivals:
        stamp, steady = stamp + by_stamp, steady + passed
        speeds.append(supervisor.on_pose(round(stamp * 1e9), stamp, FAR, CERTAIN, steady).v)
    assert speeds[-len(expected) :] == pytest.approx(expected)


@pytest.mark.parametrize("own", [0.0, 1.0])
@pytest.mark.parametrize("step", [0.8, -0.8, -5.0, -2000.0, 1e8])
def test_a_clock_that_is_set_neither_ends_a_goal_nor_stops_the_robot_for_long(step, own):
    """The clock of the sender of the poses is set, and with ``own`` the clock of the controller, too."""
    supervisor = Supervisor(SupervisorConfig())
    supervisor.on_goal(Pose(200.0, 0.0, 0.0))
    stood = x = 0.0
    for number in range(200):
        steady = 50.0 + 0.05 * number
        at = step if number >= 60 else 0.0
        command = supervisor.on_pose(
            round((1000.0 + steady + at) * 1e9), 1000.0 + steady + own * at, Pose(x, 0.0, 0.0), steady=steady
        )
        x += 0.05 * (command.v if command else 0.0)
        stood += 0.05 * (number >= 60 and not command)
    assert supervisor.goals.present is not None
    assert supervisor.state.name == "DRIVING"
    assert supervisor.elapsed == pytest.approx(10.0, abs=1.1)
    assert stood < 0.2
    assert x > 2.0
