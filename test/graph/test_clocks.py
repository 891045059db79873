"""The wall clock of the plant and its pause, and a controller before the first /clock.

Resets and other clocks are in test_lockstep.py and test_watch.py.
"""

import itertools
import time

from builtin_interfaces.msg import Time
from geometry_msgs.msg import Twist
from lockstep_drive import take_what_is_under_way
from robot import on_truth, planar, pose_stamped, stamp
from rosgraph_msgs.msg import Clock

from diffbot_control.controller_node import ControllerNode
from diffbot_control.goals.states import DRIVING
from diffbot_core.geometry import Pose
from diffbot_core.uncertainty import CERTAIN

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


def test_goals_and_poses_from_before_the_first_clock_count_as_of_that_clock(nodes):
    node = nodes.add(ControllerNode, {"use_sim_time": True, "publish_when_idle": True, "goal_timeout": 10.0})
    node.goals.accept(pose_stamped(1.0, 2.0, 0.5), "action", "1" * 32)
    assert node.supervisor.goals.present.request.time == 0.0
    last, place = 5000 * 10**9, Pose(-3.0, 2.0, 0.5)
    node.take_pose(last - 10**8, place, CERTAIN)
    node.take_pose(last, place, CERTAIN)
    clocks = nodes.peer.publisher(Clock, "/clock")
    commands = nodes.peer.subscribe(Twist, "cmd_vel")
    nodes.peer.wait_for_publishers("cmd_vel")
    nodes.peer.wait_for_subscribers(clocks)
    clocks.publish(Clock(clock=Time(sec=5000)))
    nodes.peer.spin_until(lambda: node.now() == 5000.0, what="the clock")
    node.take_pose(last + 10**8, place, CERTAIN)
    nodes.peer.spin_until(lambda: commands, what="the answer")
    assert commands[0].linear.x > 0.0
    assert node.supervisor.status == DRIVING
    assert node.supervisor.elapsed <= 1.0
