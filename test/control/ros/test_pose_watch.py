"""Until when the controller may drive by the poses that have come, with made-up time."""

from types import SimpleNamespace

import pytest

from diffbot_control.ros.parameters.controller import ControllerNodeConfig
from diffbot_control.ros.pose_watch import PoseWatch

CONFIG = ControllerNodeConfig()
TIMEOUT = CONFIG.supervisor.pose_timeout
STEP = 0.01


class Story:
    """A watch with a steady clock; the sender's clock is an hour ahead."""

    def __init__(self, simulated=False):
        self.now = 100.0
        clock = SimpleNamespace(is_simulated=simulated, is_unreliable=False, standstill=lambda: 0.0)
        self.watch = PoseWatch(clock, lambda: self.now)

    def drive(self, delay=0.005):
        """Poses of two seconds; return when the newest would have been due."""
        for _ in range(20):
            self.now += 0.1
            self.pose(self.now - delay)
        return self.now

    def pose(self, measured):
        return self.watch.on_pose(round((measured + 3600.0) * 1e9))

    def stops_at(self, config=CONFIG):
        begin = self.now
        while not self.watch.is_stale(config):
            self.now += STEP
            assert self.now < begin + 100.0, "the robot may drive for ever"
        return self.now


@pytest.mark.parametrize("held_up", [0.0, 0.13, 0.45])
def test_a_late_pose_moves_the_robot_no_longer_than_one_in_time(held_up):
    story = Story()
    due = story.drive() + 0.1
    story.now = due + held_up
    assert story.pose(due - 0.005)
    assert story.stops_at() == pytest.approx(due + TIMEOUT, abs=2 * STEP)


def test_poses_that_come_later_than_the_timeout_do_not_move_the_robot_until_one_is_in_time():
    story = Story()
    due = story.drive()
    story.now = due + 0.95
    for measured in (due + 0.1, due + 0.2, due + 0.3):
        story.pose(measured)
        assert story.watch.is_stale(CONFIG)
    story.pose(story.now - 0.005)
    assert not story.watch.is_stale(CONFIG)


def test_in_simulated_time_stamps_may_fall_behind_the_steady_clock_which_ends_a_silence_by_the_factor():
    story, stamp = Story(simulated=True), 0.0
    for _ in range(100):
        story.now, stamp = story.now + 0.4, stamp + 0.1
        story.pose(stamp)
        assert not story.watch.is_stale(CONFIG)
    last, slow = story.now, CONFIG._replace(real_timeout_factor=10.0)
    assert story.stops_at() == pytest.approx(last + TIMEOUT, abs=2 * STEP)
    assert story.stops_at(slow) == pytest.approx(last + 10.0 * TIMEOUT, abs=2 * STEP)
    lockstep = CONFIG._replace(supervisor=CONFIG.supervisor._replace(publish_when_idle=True))
    assert not story.watch.is_stale(lockstep), "the plant waits"
