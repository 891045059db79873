"""The plant's clocks, its pause and its reset."""

import itertools
import time

import pytest
from lockstep_drive import take_what_is_under_way
from robot import on_truth, planar, stamp
from rosgraph_msgs.msg import Clock
from std_srvs.srv import Trigger

PLACE = {"initial_pose.x": 3.0, "initial_pose.y": -1.0, "initial_pose.yaw": 1.0}
PERIOD = 100_000_000


@pytest.fixture(scope="module")
def walking():
    with on_truth({**PLACE, "start_paused": True, "seed": 9}) as running:
        running.clocks = running.peer.subscribe(Clock, "/clock", 100)
        yield running


def test_wall_clock_stamps_each_step_with_the_time_of_day_and_a_pause_sends_nothing(walking):
    walking.catch_up()
    assert not walking.truths
    began = time.time_ns()
    assert walking.pause(False).message == "running"
    walking.peer.spin_until(lambda: len(walking.truths) >= 25, what="25 steps")
    stamps = [stamp(message) for message in walking.truths]
    assert {after - before for before, after in itertools.pairwise(stamps)} == {PERIOD}
    assert began <= stamps[0] <= time.time_ns()
    assert planar(walking.truths[0].pose.pose) == (3.0, -1.0, 1.0)
    assert not walking.clocks, "wall time needs no /clock"
    assert walking.pause(True).message == "paused"
    take_what_is_under_way(walking)
    count = len(walking.truths)
    walking.peer.spin_for(1.0)
    assert len(walking.truths) == count
    walking.pause(False)
    walking.peer.spin_until(lambda: len(walking.truths) > count, what="steps")
    # Wall time goes on in a pause.
    assert stamp(walking.truths[count]) - stamp(walking.truths[count - 1]) > 0.9e9


def test_reset_puts_it_back_without_turning_back_time(walking):
    walking.send_goal(0.0, 0.0, 0.0)
    walking.peer.spin_until(lambda: planar(walking.truths[-1].pose.pose)[0] != 3.0, what="motion")
    walking.cancel()
    walking.peer.spin_until(lambda: walking.truths[-1].twist.twist.linear.x == 0.0, what="rest")
    count = len(walking.truths)
    assert walking.peer.call(Trigger, "plant/reset").success
    walking.peer.spin_until(lambda: planar(walking.truths[-1].pose.pose) == (3.0, -1.0, 1.0), what="the start pose")
    stamps = [stamp(message) for message in walking.truths[count - 1 :]]
    assert all(after > before for before, after in itertools.pairwise(stamps))
