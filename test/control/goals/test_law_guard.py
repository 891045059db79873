"""The supervisor with custom laws: their input, the limits, braking, and laws that fail in any function."""

import math
from typing import NamedTuple

import pytest

from diffbot_control.goals import Supervisor, SupervisorConfig
from diffbot_control.goals.record import NOT_REACHED, REPLACED
from diffbot_control.goals.states import DRIVING, IDLE, NOT_AT_GOAL
from diffbot_control.law import CONTACT, CONTACT_UNKNOWN, GoalTolerance, Law, Report
from diffbot_control.law.law import LawError
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
    tolerance: GoalTolerance = GoalTolerance()


class Memory(NamedTuple):
    reached: bool = False
    sent: tuple = ()
    """commands and times that after_command has received"""


class Scripted(Law):
    """A law whose memory records the calls of after_command."""

    name, Config = "scripted", Config

    @staticmethod
    def new_memory(config):
        return Memory()

    @staticmethod
    def after_command(memory, command, dt, config):
        return memory._replace(sent=(*memory.sent, (command, dt)))


def scripted(**functions):
    """Return a law with some functions of the test; ``asked`` records the arguments of its step."""
    answer = functions.pop("answer", None) or (lambda memory: (memory, Twist(0.5, 0.1), GOOD_REPORT))
    asked = []

    def step(memory, observation, goal, config):
        asked.append((memory, observation, goal, config))
        return law.answer(memory)

    members = {name: staticmethod(function) for name, function in functions.items()}
    law = type(
        "Law", (Scripted,), {"step": staticmethod(step), "asked": asked, "answer": staticmethod(answer), **members}
    )
    return law


class Drive:
    """A supervisor with a law; a pose arrives every 0.1 s by default."""

    def __init__(self, law, controller=None, **options):
        config = SupervisorConfig(law.Config() if controller is None else controller, **options)
        self.supervisor, self.now = Supervisor(config, law), 100.0
        self.supervisor.on_goal(GOAL)

    def pose(self, pose=AWAY, uncertainty=UNSURE, after=0.1):
        self.now += after
        return self.supervisor.on_pose(round(self.now * 1e9), self.now, pose, uncertainty)

    def cruise(self):
        """Accelerate to the 0.5 m/s of the scripted law."""
        return [self.pose() for _ in range(6)][-1]


def test_the_law_gets_pose_uncertainty_goal_and_its_configuration():
    law = scripted()
    drive = Drive(law, uncertainty_scale=2.0)
    drive.pose()
    drive.pose()
    estimate = Estimate(AWAY, Uncertainty(0.06, 0.02))
    for (_, observation, goal, config), dt in zip(law.asked, (0.0, 0.1), strict=True):
        assert (observation.estimate, goal, config) == (estimate, GOAL, Config())
        assert observation.dt == pytest.approx(dt)
    assert drive.supervisor.status == DRIVING


def test_the_law_gets_contact_and_the_median_period_which_one_odd_pose_does_not_change():
    law = scripted()
    drive = Drive(law)
    for after in (0.05, 0.05, 0.05, 0.3, 0.0, 0.05, 0.02, 0.05):
        drive.pose(after=after)
    drive.supervisor.contact = CONTACT
    drive.pose(after=0.05)
    observations = [observation for _, observation, _, _ in law.asked]
    assert [one.dt for one in observations] == pytest.approx([0.0, 0.05, 0.05, 0.3, 0.05, 0.02, 0.05, 0.05], abs=1e-6)
    assert [one.period for one in observations] == pytest.approx([0.1, *[0.05] * 7], abs=1e-6)
    assert [one.contact for one in observations] == [CONTACT_UNKNOWN] * 7 + [CONTACT]


def test_every_command_keeps_the_limits_and_the_law_receives_the_commands_that_it_did_not_give():
    law = scripted(answer=lambda memory: (memory, Twist(9.0, 0.0), GOOD_REPORT))
    drive = Drive(law)
    assert [drive.pose().v for _ in range(4)] == pytest.approx([0.0, 0.1, 0.2, 0.3])
    assert [command.v for command, _ in drive.supervisor.memory.sent] == pytest.approx([0.0, 0.1, 0.2, 0.3])
    assert {dt for _, dt in drive.supervisor.memory.sent} == {0.0}
    law.answer = staticmethod(lambda memory: (memory, Twist(0.35, 0.1), GOOD_REPORT))
    drive.pose()
    assert len(drive.supervisor.memory.sent) == 4, "the command was within the limits"


def test_a_cancelled_robot_brakes_within_the_limits():
    drive = Drive(scripted())
    assert drive.cruise() == pytest.approx((0.5, 0.1))
    drive.supervisor.on_cancel("by the test")
    speeds = [drive.pose() or ZERO for _ in range(6)]
    # 0.1 m/s in 0.1 s; both velocities together, along the curve.
    assert speeds[:5] == [pytest.approx((0.5 - 0.1 * n, 0.1 - 0.02 * n), abs=1e-12) for n in range(1, 6)]
    assert speeds[5] == pytest.approx(ZERO, abs=1e-12)
    assert drive.supervisor.status == IDLE
    braking = [one for one in drive.supervisor.memory.sent if one[1] > 0.0]
    assert [command for command, _ in braking] == speeds, "the law receives these commands"
    assert [dt for _, dt in braking] == pytest.approx([0.1] * 6)


def raising(_memory):
    raise ValueError("two\nlines")


FAILURES = {
    "nan": (
        lambda memory: (memory, Twist(math.nan, 0.0), GOOD_REPORT),
        "its command is not finite: v = nan m/s, omega",
    ),
    "raises": (raising, "ValueError: two lines (test_law_guard.py:"),
    "no command": (lambda memory: (memory, None, GOOD_REPORT), "TypeError: "),
    "short report": (lambda memory: (memory, Twist(0.0, 0.0), (1.0,)), "its report has 1 of 7 variables"),
    "odd reached": (lambda memory: (Memory("yes"), Twist(0.0, 0.0), GOOD_REPORT), "memory.reached is 'yes': must be"),
}


@pytest.mark.parametrize("failure", FAILURES)
def test_a_step_that_fails_ends_the_goal_with_the_reason_and_the_robot_brakes(failure):
    answer, reason = FAILURES[failure]
    law = scripted()
    drive = Drive(law)
    drive.cruise()
    law.answer = staticmethod(answer)
    assert drive.pose() == pytest.approx((0.4, 0.08))
    supervisor = drive.supervisor
    assert (supervisor.status, supervisor.goal, supervisor.has_failed) == (NOT_AT_GOAL, None, True)
    assert supervisor.reason.startswith("law scripted failed: ")
    assert reason in supervisor.reason
    assert "\n" not in supervisor.reason
    assert [drive.pose() for _ in range(4)][-1] == pytest.approx(ZERO, abs=1e-12)
    law.answer = staticmethod(lambda memory: (memory, Twist(0.1, 0.0), GOOD_REPORT))
    supervisor.on_goal(GOAL)
    assert (drive.pose(), supervisor.reason, supervisor.has_failed) == (pytest.approx((0.1, 0.0)), "", False)


@pytest.mark.parametrize("function", ["reason_to_give_up", "data_sheet", "tolerance", "after_command", "describe"])
def test_a_law_that_fails_in_any_other_function_ends_the_goal_too(function):
    law = scripted()
    drive = Drive(law)
    drive.cruise()
    setattr(law, function, staticmethod(lambda *_: {}["missing"]))
    assert drive.supervisor.description() == {}
    drive.supervisor.on_tick(drive.now + 1.0)  # without a pose, zero is sent, and the law receives it
    drive.pose()
    (record,) = drive.supervisor.goals.ended
    assert (record.end, drive.supervisor.status, drive.supervisor.has_failed) == (NOT_REACHED, NOT_AT_GOAL, True)
    assert record.reason.startswith("law scripted failed: KeyError: 'missing' (test_law_guard.py:")
    assert [drive.pose() for _ in range(9)][-1] in (None, ZERO)


def test_a_law_that_cannot_begin_ends_its_goal():
    law = scripted()
    drive = Drive(law)
    law.new_memory = staticmethod(lambda _: {}["missing"])
    drive.supervisor.on_goal(GOAL)
    assert [record.end for record in drive.supervisor.goals.ended] == [REPLACED, NOT_REACHED]
    with pytest.raises(LawError, match="law scripted failed: KeyError"):
        Supervisor(SupervisorConfig(Config()), law)


def test_a_law_that_fails_at_the_next_goal_of_a_path_ends_the_path_and_brakes():
    law = scripted()
    drive = Drive(law, waypoint_radius=1.0)
    drive.supervisor.on_path([AWAY._replace(x=-8.0), GOAL])
    drive.cruise()
    law.new_memory = staticmethod(lambda _: {}["missing"])
    assert drive.pose(AWAY._replace(x=-8.1)) == pytest.approx((0.4, 0.08))
    assert [record.end for record in drive.supervisor.goals.ended] == [REPLACED, NOT_REACHED]
    assert (drive.supervisor.status, drive.supervisor.goal) == (NOT_AT_GOAL, None)


def test_a_law_may_give_up_and_describe_its_memory():
    law = scripted(reason_to_give_up=lambda memory, config: "bored", describe=lambda memory, config: {"mood": 3})
    drive = Drive(law)
    drive.pose()
    assert [(one.end, one.reason) for one in drive.supervisor.goals.ended] == [(NOT_REACHED, "bored")]
    assert drive.supervisor.description() == {"mood": "3"}
