"""Odometry whose stamps stand still while fixes go on: the robot stands, the goal ends, and /diagnostics names it."""

import math
import time

import pytest
from filter_input import fix, odometry
from geometry_msgs.msg import PoseWithCovarianceStamped
from graph import PATIENCE
from nav_msgs.msg import Odometry
from robot import robot, twist

ERROR = b"\x02"


@pytest.mark.parametrize("only", [("ekf", "controller"), ("robot",)], ids=["two nodes", "one process"])
def test_odometry_that_repeats_its_stamp_stops_the_robot_and_loses_the_goal(only):
    with robot(controller={"pose_lost_timeout": 2.0}, only=only) as running:
        peer = running.peer
        odom, fixes = peer.publisher(Odometry, "odom"), peer.publisher(PoseWithCovarianceStamped, "global_pose")
        peer.wait_for_subscribers(odom, fixes)
        frozen, fed = [], [0.0]

        def feed():
            now = time.time()
            if abs(now - fed[0]) < 0.02:
                return
            fed[0] = now
            # It does not move: fixes that stand still while the odometry moves are a fault of their own.
            odom.publish(odometry(frozen[0] if frozen else now, 0.0, 0.0))
            fixes.publish(fix(now, 0.0, 0.0, 0.0))

        def until(condition, what):
            peer.spin_until(lambda: feed() or condition(), PATIENCE, what)

        until(lambda: running.poses, "a pose")
        running.send_goal(50.0, 0.0, 0.0)
        until(lambda: running.commands and twist(running.commands[-1])[0] > 0.3, "motion")
        frozen.append(time.time())
        until(lambda: running.state() == "stale pose", "the watch")
        until(lambda: twist(running.commands[-1]) == (0.0, 0.0), "the stop")
        count = len(running.commands)
        until(lambda: len(running.commands) > count + 20 or running.state() != "stale pose", "more commands")
        until(lambda: running.state() == "goal not reached", "the end of the goal")
        peer.spin_until_quiet()
        assert {twist(command) for command in running.commands[count:]} == {(0.0, 0.0)}
        reasons = {pair.value for pair in running.controller_states[-1].values if pair.key == "reason"}
        assert reasons == {"no pose for pose_lost_timeout = 2 s"}
        until(lambda: running.ekf_states[-1].message == "no odometry", "silence")
        running.diagnostics.clear()

        def reported():
            return [
                status
                for array in running.diagnostics
                for status in array.status
                if status.name.endswith("/ekf") and "odometry stands still" in status.message
            ]

        until(reported, "the diagnosis")
        assert reported()[-1].level == ERROR


def test_fixes_turned_against_the_odometry_stop_the_robot_and_end_its_goal():
    with robot(controller={"pose_lost_timeout": 2.0}, only=("robot",)) as running:
        peer = running.peer
        odom, fixes = peer.publisher(Odometry, "odom"), peer.publisher(PoseWithCovarianceStamped, "global_pose")
        peer.wait_for_subscribers(odom, fixes)
        began, fed = time.time(), [0.0]

        def feed():
            now = time.time()
            if abs(now - fed[0]) >= 0.02:
                fed[0] = now
                odom.publish(odometry(now, 1.0, 0.0))
                fixes.publish(fix(now, now - began, 0.0, math.pi))

        def until(condition, what):
            peer.spin_until(lambda: feed() or condition(), PATIENCE, what)

        until(lambda: running.poses, "a pose")
        running.send_goal(500.0, 0.0, 0.0)
        until(lambda: running.ekf_states and running.ekf_states[-1].message == "poses withheld", "the contradiction")
        until(lambda: running.state() == "goal not reached", "the end of the goal")
        until(lambda: twist(running.commands[-1]) == (0.0, 0.0), "the stop")
        assert running.ekf_states[-1].level == ERROR
        reasons = {pair.value for pair in running.ekf_states[-1].values if pair.key == "reason"}
        assert reasons == {"fixes contradict the odometry"}
