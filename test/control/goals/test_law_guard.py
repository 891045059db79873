"""The supervisor with custom laws: their input, the limits, braking, and laws that fail in any function."""

import math
from typing import NamedTuple

import pytest

from diffbot_control.goals import Supervisor, SupervisorConfig
from diffbot_control.goals.record import NOT_REACHED, REPLACED
from diffbot_control.goals.states import IDLE, NOT_AT_GOAL
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


def test_the_law_gets_the_scaled_estimate_goal_configuration_contact_and_the_median_period():
    law = scripted()
    drive = Drive(law, uncertainty_scale=2.0)
    # One odd pose does not change the period.
    for after in (0.05, 0.05, 0.05, 0.3, 0.0, 0.05, 0.02, 0.05):
        drive.pose(after=after)
    drive.supervisor.contact = CONTACT
    drive.pose(after=0.05)
    seen = [observation for _, observation, _, _ in law.asked]
    assert {one.estimate for one in seen} == {Estimate(AWAY, Uncertainty(0.06, 0.02))}
    assert {(goal, config) for _, _, goal, config in law.asked} == {(GOAL, Config())}
    assert [one.dt for one in seen] == pytest.approx([0.0, 0.05, 0.05, 0.3, 0.05, 0.02, 0.05, 0.05], abs=1e-6)
    assert [one.period for one in seen] == pytest.approx([0.1, *[0.05] * 7], abs=1e-6)
    assert [one.contact for one in seen] == [CONTACT_UNKNOWN] * 7 + [CONTACT]


def test_every_command_keeps_the_limits_and_the_law_receives_the_commands_that_it_did_not_give():
    law = scripted(answer=lambda memory: (memory, Twist(9.0, 0.0), GOOD_REPORT))
    drive = Drive(law)
    assert [drive.pose().v for _ in range(4)] == pytest.approx([0.0, 0.1, 0.2, 0.3])
    assert [command.v for command, _ in drive.supervisor.memory.sent] == pytest.approx([0.0, 0.1, 0.2, 0.3])
    assert {dt for _, dt in drive.supervisor.memory.sent} == {0.0}
    law.answer = staticmethod(lambda memory: (memory, Twist(0.35, 0.1), GOOD_REPORT))
    drive.pose()
    assert len(drive.supervisor.memory.sent) == 4, "the command was within the limits"


def test_a_cancelled_robot_brakes_within_the_limits_and_the_law_receives_these_commands():
    drive = Drive(scripted())
    assert drive.cruise() == pytest.approx((0.5, 0.1))
    drive.supervisor.on_cancel("by the test")
    speeds = [drive.pose() or ZERO for _ in range(6)]
    # 0.1 m/s in 0.1 s; both velocities together, along the curve.
    assert speeds == [pytest.approx((0.5 - 0.1 * n, 0.1 - 0.02 * n), abs=1e-12) for n in (1, 2, 3, 4, 5, 5)]
    assert drive.supervisor.status == IDLE
    braking = [one for one in drive.supervisor.memory.sent if one[1] > 0.0]
    assert [command for command, _ in braking] == speeds
    assert [dt for _, dt in braking] == pytest.approx([0.1] * 6)


def raising(_memory):
    raise ValueError("two\nlines")


FAILURES = [
    (lambda memory: (memory, Twist(math.nan, 0.0), GOOD_REPORT), "its command is not finite: v = nan m/s, omega"),
    (raising, "ValueError: two lines (test_law_guard.py:"),
    (lambda memory: (memory, None, GOOD_REPORT), "TypeError: "),
    (lambda memory: (memory, Twist(0.0, 0.0), (1.0,)), "its report has 1 of 7 variables"),
    (lambda memory: (Memory("yes"), Twist(0.0, 0.0), GOOD_REPORT), "memory.reached is 'yes': must be"),
]


@pytest.mark.parametrize(("answer", "reason"), FAILURES)
def test_a_step_that_fails_ends_the_goal_with_the_reason_and_the_robot_brakes(answer, reason):
    law = scripted()
    drive = Drive(law)
    drive.cruise()
    law.answer = staticmethod(answer)
    assert drive.pose() == pytest.approx((0.4, 0.08))
    supervisor = drive.supervisor
    assert (supervisor.status, supervisor.goal, supervisor.has_failed) == (NOT_AT_GOAL, None, True)
    assert supervisor.reason.startswith(f"law scripted failed: {reason}")
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


def test_a_law_that_fails_at_its_start_is_refused():
    law = scripted(new_memory=lambda _: {}["missing"])
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
    drive = Drive(scripted(reason_to_give_up=lambda *_: "bored", describe=lambda *_: {"mood": 3}))
    drive.pose()
    assert [(one.end, one.reason) for one in drive.supervisor.goals.ended] == [(NOT_REACHED, "bored")]
    assert drive.supervisor.description() == {"mood": "3"}
