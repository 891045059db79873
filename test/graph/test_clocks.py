"""The plant's wall clock and its pause; resets and other clocks are in test_lockstep.py and test_watch.py."""

import itertools
import time

from lockstep_drive import take_what_is_under_way
from robot import on_truth, planar, stamp
from rosgraph_msgs.msg import Clock

PLACE = {"initial_pose.x": 3.0, "initial_pose.y": -1.0, "initial_pose.yaw": 1.0}
PERIOD = 100_000_000


def test_wall_clock_stamps_each_step_with_the_time_of_day_and_a_pause_sends_nothing():
    with on_truth({**PLACE, "start_paused": True}) as robot:
        clocks = robot.peer.subscribe(Clock, "/clock", 100)
        robot.catch_up()
        assert not robot.truths
        began = time.time_ns()
        assert robot.pause(False).message == "running"
        robot.peer.spin_until(lambda: len(robot.truths) >= 25, what="25 steps")
        stamps = [stamp(message) for message in robot.truths]
        assert {after - before for before, after in itertools.pairwise(stamps)} == {PERIOD}
        assert began <= stamps[0] <= time.time_ns()
        assert planar(robot.truths[0].pose.pose) == (3.0, -1.0, 1.0)
        assert not clocks, "wall time needs no /clock"
        assert robot.pause(True).message == "paused"
        take_what_is_under_way(robot)
        count = len(robot.truths)
        robot.peer.spin_for(1.0)
        assert len(robot.truths) == count
        robot.pause(False)
        robot.peer.spin_until(lambda: len(robot.truths) > count, what="steps")
        # Wall time goes on in a pause.
        assert stamp(robot.truths[count]) - stamp(robot.truths[count - 1]) > 0.9e9
