"""Floods of goals: how many are accepted, and that the newest one always is."""

from types import SimpleNamespace

import pytest

from diffbot_control.ros.goals.intake import BURST, PERIOD, SUPERSEDED, GoalIntake
from diffbot_core.geometry import Pose
from diffbot_core.health import Health


class Intake:
    """An intake in a node of which there is only what it needs, with a clock and a timer of the test."""

    def __init__(self):
        self.now, self.accepted, self.health = 100.0, [], Health()
        self.due = None
        node = SimpleNamespace(create_timer=self._timer, steady_clock=None, health=self.health)
        self.intake = GoalIntake(node, lambda goal: self.accepted.append(goal.x), lambda: self.now)

    def _timer(self, period, callback, clock):
        self.fire = callback

        def reset():
            self.due = self.now + period

        return SimpleNamespace(reset=reset, cancel=lambda: setattr(self, "due", None))

    def take(self, number):
        self.intake.take(Pose(float(number), 0.0, 0.0))

    def wait(self, seconds):
        end = self.now + seconds
        while self.due is not None and self.due <= end:
            self.now = self.due
            self.due = self.now + PERIOD
            self.fire()
        self.now = end


@pytest.mark.parametrize("rate", [50, 1000])
def test_of_a_flood_so_many_are_accepted_and_the_newest_one_at_the_end(rate):
    one = Intake()
    for number in range(10 * rate):
        one.take(number)
        one.wait(1.0 / rate)
    # Those of a user at once.
    assert one.accepted[:BURST] == [float(number) for number in range(BURST)]
    one.wait(PERIOD)
    assert one.accepted[-1] == 10 * rate - 1
    assert one.accepted == sorted(one.accepted)
    # Less than one each period: the timer starts with a goal that comes after the last one was accepted.
    assert 0.5 * 10.0 / PERIOD <= len(one.accepted) <= 10.0 / PERIOD + BURST + 1
    assert one.health.counted[SUPERSEDED] == 10 * rate - len(one.accepted)


def test_goal_that_waits_can_be_dropped():
    one = Intake()
    assert not one.intake.drop()
    for number in range(BURST + 1):
        one.take(number)
    assert one.intake.drop()
    one.wait(1.0)
    assert one.accepted[-1] == BURST - 1
