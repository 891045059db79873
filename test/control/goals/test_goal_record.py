"""Each goal that is accepted ends exactly once, whatever happens to it."""

import math

import pytest

from diffbot_control.goals import Supervisor, SupervisorConfig
from diffbot_control.goals.goal_record import (
    POSE_LOST,
    REPLACED,
    GoalBook,
    GoalRequest,
    distance_along,
    time_remaining,
)
from diffbot_control.goals.states import NOT_AT_GOAL as GIVEN_UP
from diffbot_control.law.presets import PRESETS
from diffbot_core.geometry import Pose

PAPER = PRESETS["paper"]
QUICK = PAPER._replace(tolerance=PAPER.tolerance._replace(settling_steps=1))
GOAL, AWAY, THERE = Pose(0.0, 0.0, 0.0), Pose(-3.0, 0.5, 0.3), Pose(-0.01, 0.0, 0.0)


class Drive:
    """A supervisor whose goals are numbered, with a clock of its own."""

    def __init__(self, **options):
        self.supervisor = Supervisor(SupervisorConfig(**{"controller": QUICK, **options}))
        self.now, self.count = 50.0, 0

    def request(self):
        self.count += 1
        return GoalRequest(f"{self.count}", "test", self.now)

    def goal(self, goal=GOAL):
        self.supervisor.on_goal(goal, self.request())

    def path(self, goals=(AWAY, GOAL)):
        self.supervisor.on_path(list(goals), self.request())

    def pose(self, pose=AWAY, after=0.1):
        self.now += after
        return self.supervisor.on_pose(round(self.now * 1e9), self.now, pose)

    def silence(self, seconds):
        for _ in range(round(seconds * 10)):
            self.now += 0.1
            self.supervisor.on_tick(self.now)

    def ends(self):
        return [(record.request.id, record.end) for record in self.supervisor.goals.ended]

    def reason(self):
        return self.supervisor.goals.ended[-1].reason


@pytest.mark.parametrize("before", ["nothing", "a long silence", "a pose", "a clock set back"])
def test_a_goal_without_poses_ends_after_pose_lost_timeout(before):
    drive = Drive(pose_lost_timeout=2.0)
    if before == "a long silence":
        drive.pose()
        drive.silence(10.0)
    drive.goal()
    if before in ("a pose", "a clock set back"):
        drive.pose()
    if before == "a clock set back":
        drive.now = 0.0
    drive.silence(1.8)
    assert drive.ends() == []
    drive.silence(0.5)
    assert drive.ends() == [("1", POSE_LOST)]
    assert drive.reason() == "no pose for pose_lost_timeout = 2 s"
    assert (drive.supervisor.status, drive.supervisor.goal) == (GIVEN_UP, None)


def test_a_book_knows_its_goals_by_their_ids_and_forgets_the_oldest():
    book = GoalBook()
    for number in range(40):
        book.close(REPLACED)
        book.accept(GoalRequest(str(number)))
    assert book.find("39") is book.present
    assert book.find("38").end == REPLACED
    assert book.find("7").end == REPLACED
    assert book.find("6") is None
    assert GoalBook().find("") is None
    book.accept(GoalRequest())
    assert book.find("") is None, "a goal without an id cannot be asked for"


def test_distance_runs_through_all_goals():
    assert distance_along(Pose(0.0, 0.0, 1.0), [Pose(3.0, 4.0, 0.0), Pose(3.0, 5.0, 2.0)]) == pytest.approx(6.0)
    assert distance_along(Pose(0.0, 0.0, 1.0), []) == 0.0


def test_time_remaining_begins_with_the_limit_and_goes_on_with_the_mean_speed():
    assert time_remaining(4.0, 4.0, 0.0, 0.5) == pytest.approx(8.0)
    assert time_remaining(3.9, 4.0, 10.0, 0.5) == pytest.approx(7.8), "too early for a mean"
    assert time_remaining(1.0, 4.0, 6.0, 0.5) == pytest.approx(2.0), "3 m in 6 s"
    assert time_remaining(0.0, 4.0, 6.0, 0.5) == 0.0
    assert time_remaining(4.0, 4.0, 0.0, math.inf) == 0.0
