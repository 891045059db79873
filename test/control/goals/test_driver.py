"""The supervisor with laws of others: motion that outlives a goal, coming to rest, and laws that fail."""

import math
from typing import NamedTuple

import pytest

from diffbot_control.goals import Supervisor, SupervisorConfig
from diffbot_control.goals.states import DRIVING, IDLE, NOT_AT_GOAL
from diffbot_control.law.configuration import Report
from diffbot_core.data_sheet import DataSheet
from diffbot_core.geometry import Pose
from diffbot_core.kinematics import Twist
from diffbot_core.uncertainty import Estimate, Uncertainty

ZERO = (0.0, 0.0)
SLOW = DataSheet(a_max=1.0, omega_dot_max=2.0)
UNSURE = Uncertainty(0.03, 0.01)
AWAY, GOAL = Pose(-9.0, 0.0, 0.0), Pose(0.0, 0.0, 0.0)
GOOD_REPORT = Report(9.0, 0.0, 0.0, 0.0, 0.0, 0, 0.0)


class Config(NamedTuple):
    data_sheet: DataSheet = SLOW


class Memory(NamedTuple):
    reached: bool = False
    seen: float = 0.0
    command: float = 7.0
    """of a law that means something else by this name"""


class Scripted:
    """A law that answers what the test says, and remembers what it was asked."""

    name, Config = "scripted", Config

    def __init__(self, answer=None):
        self.answer = answer or (lambda memory: (memory, Twist(0.5, 0.1), GOOD_REPORT))
        self.asked = []

    def new_memory(self, config):
        return Memory()

    def step(self, memory, estimate, goal, dt, config):
        self.asked.append((memory, estimate, goal, dt, config))
        return self.answer(memory)


class Drive:
    """A supervisor with a law; poses come every 0.1 s."""

    def __init__(self, law, controller=None, **options):
        config = SupervisorConfig(law.Config() if controller is None else controller, **options)
        self.supervisor, self.now = Supervisor(config, law), 100.0
        self.supervisor.on_goal(GOAL)

    def pose(self, pose=AWAY, uncertainty=UNSURE):
        self.now += 0.1
        return self.supervisor.on_pose(round(self.now * 1e9), self.now, pose, uncertainty)

    def cruise(self):
        """Come up to the 0.5 m/s of the scripted law, from the first pose on."""
        return [self.pose() for _ in range(6)][-1]


def test_the_law_gets_pose_uncertainty_goal_period_and_its_configuration():
    law = Scripted()
    drive = Drive(law)
    drive.pose()
    drive.pose()
    estimate = Estimate(AWAY, UNSURE)
    assert law.asked == [(Memory(), estimate, GOAL, dt, Config()) for dt in (0.0, pytest.approx(0.1))]
    assert drive.supervisor.status == DRIVING


@pytest.mark.parametrize("sheet", [SLOW, None])
def test_a_cancelled_robot_brakes_within_the_limits_or_at_once_without_a_data_sheet(sheet):
    drive = Drive(Scripted(), controller=Config(sheet))
    assert drive.cruise() == pytest.approx((0.5, 0.1))
    drive.supervisor.on_cancel()
    speeds = [drive.pose() or ZERO for _ in range(6)]
    # 0.1 m/s in 0.1 s; both velocities together, along the curve.
    expected = [(0.5 - 0.1 * n, 0.1 - 0.02 * n) for n in range(1, 6)] if sheet else [ZERO] * 5
    assert speeds[:5] == [pytest.approx(one, abs=1e-12) for one in expected]
    assert speeds[5] == pytest.approx(ZERO, abs=1e-12)
    assert drive.supervisor.status == IDLE
    assert drive.supervisor.memory == Memory(), "a field of the same name and another type is the law's own"


def raising(_memory):
    raise ValueError("two\nlines")


FAILURES = {
    "nan": (lambda memory: (memory, Twist(math.nan, 0.0), GOOD_REPORT), "v = nan m/s, omega = 0.0 rad/s: must be fin"),
    "raises": (raising, "ValueError: two lines (test_driver.py:"),
    "no command": (lambda memory: (memory, None, GOOD_REPORT), "AttributeError: "),
    "short report": (
        lambda memory: (memory, Twist(0.0, 0.0), (1.0,)),
        "'reached' or the report is not as the protocol",
    ),
    "odd reached": (lambda memory: (Memory("yes"), Twist(0.0, 0.0), GOOD_REPORT), "'reached' or the report is not as"),
}


@pytest.mark.parametrize("failure", FAILURES)
def test_a_law_that_fails_on_the_way_ends_the_goal_with_the_reason_and_the_robot_brakes(failure):
    answer, reason = FAILURES[failure]
    law = Scripted()
    drive = Drive(law)
    drive.cruise()
    law.answer = answer
    assert drive.pose() == pytest.approx((0.4, 0.08))
    supervisor = drive.supervisor
    assert (supervisor.status, supervisor.goal, supervisor.has_failed) == (NOT_AT_GOAL, None, True)
    assert supervisor.reason.startswith("law scripted failed: ")
    assert reason in supervisor.reason
    assert "\n" not in supervisor.reason
    assert [drive.pose() for _ in range(4)][-1] == pytest.approx(ZERO, abs=1e-12)
    law.answer = lambda memory: (memory, Twist(0.1, 0.0), GOOD_REPORT)
    supervisor.on_goal(GOAL)
    assert (drive.pose(), supervisor.reason, supervisor.has_failed) == (pytest.approx((0.1, 0.0)), "", False)
