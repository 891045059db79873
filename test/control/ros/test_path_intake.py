"""Long paths in slices: what is read between two other callbacks, and what ends the reading."""

from types import SimpleNamespace

import pytest

from diffbot_control.ros.goals.path_intake import SLICE, PathIntake
from diffbot_core.errors import BadMessageError
from diffbot_core.geometry import Pose
from diffbot_core.health import Health


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
