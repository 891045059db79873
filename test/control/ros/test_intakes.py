"""Floods of goals, of which the newest one is always accepted, and long paths, read in slices between two callbacks."""

from types import SimpleNamespace

import pytest

from diffbot_control.ros.goals.intake import BURST, PERIOD, SUPERSEDED, GoalIntake
from diffbot_control.ros.goals.path_intake import SLICE, PathIntake
from diffbot_core.errors import BadMessageError
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


class Reading:
    """An intake in a node of which there is only what it needs."""

    def __init__(self):
        self.accepted, self.taken, self.warnings = [], 0, []
        self.health = Health()
        logger = SimpleNamespace(warning=self.warnings.append)
        node = SimpleNamespace(
            create_timer=self._timer, steady_clock=None, health=self.health, get_logger=lambda: logger
        )
        self.intake = PathIntake(node, self.accepted.append)

    def _timer(self, _period, callback, clock):
        """Return a timer that is fired by hand."""
        self.timer = SimpleNamespace(callback=callback, is_on=True)
        self.timer.reset = lambda: setattr(self.timer, "is_on", True)
        self.timer.cancel = lambda: setattr(self.timer, "is_on", False)
        return self.timer

    def poses(self, length, bad=None):
        for index in range(length):
            self.taken += 1
            if index == bad:
                raise BadMessageError("position not finite", "nan")
            yield Pose(float(index), 0.0, 0.0)

    def slices(self):
        """Fire the timer until it is off; return how many poses were read each time."""
        counts = []
        while self.timer.is_on:
            before = self.taken
            self.timer.callback()
            counts.append(self.taken - before)
        return counts


@pytest.mark.parametrize("length", [SLICE - 1, SLICE, 5 * SLICE])
def test_a_path_is_accepted_whole_in_slices_of_bounded_length_a_short_one_at_once(length):
    reading = Reading()
    reading.intake.start(reading.poses(length))
    assert reading.taken == min(length, SLICE)
    assert bool(reading.accepted) == (not reading.timer.is_on) == (length < SLICE)
    assert max(reading.slices(), default=0) <= SLICE
    (goals,) = reading.accepted
    assert goals == [Pose(float(index), 0.0, 0.0) for index in range(length)]


def test_a_bad_pose_refuses_all_of_a_path_and_is_counted_once():
    reading = Reading()
    with pytest.raises(BadMessageError):
        reading.intake.start(reading.poses(1000, bad=3))
    assert not reading.timer.is_on
    for _ in range(2):
        reading.intake.start(reading.poses(1000, bad=900))
        reading.slices()
    assert not reading.accepted
    assert reading.health.dropped["path", "position not finite"] == 2
    assert len(reading.warnings) == 1


def test_a_newer_path_or_a_cancellation_ends_the_reading():
    reading = Reading()
    reading.intake.start(reading.poses(1000))
    reading.intake.start(reading.poses(500))
    reading.slices()
    assert [len(goals) for goals in reading.accepted] == [500]
    reading.intake.start(reading.poses(1000))
    assert reading.intake.drop()
    assert not reading.intake.drop()
    assert not reading.timer.is_on
    assert [len(goals) for goals in reading.accepted] == [500]
