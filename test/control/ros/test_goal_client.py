"""The client of the controller, without a controller."""

import threading
import time
from contextlib import closing

import pytest
from geometry_msgs.msg import PoseStamped

from diffbot_control.goals.record import MAX_PATH_POSES, REACHED
from diffbot_control.ros.goals.client import GoalClient, GoalRefusedError, GoalTask
from diffbot_control.ros.navigator import Navigator, TaskResult
from diffbot_core.geometry import Pose


def test_a_path_that_is_too_long_is_refused_at_once():
    refused = pytest.raises(GoalRefusedError, match="goal refused: path too long: 2001 poses, at most 2000")
    with closing(GoalClient.in_own_context()) as client, refused:
        client.send_goal([Pose(0.0, 0.0, 0.0)] * (MAX_PATH_POSES + 1), timeout=0.0)


def test_waypoints_end_if_the_controller_has_ended_between_two_of_them(monkeypatch):
    monkeypatch.setattr("diffbot_control.ros.navigator._SERVICE_TIMEOUT", 0.2)
    with closing(Navigator.in_own_context()) as navigator:
        pose = PoseStamped()
        pose.pose.orientation.w = 1.0
        monkeypatch.setattr(navigator, "goThroughPoses", lambda poses: True)
        assert navigator.followWaypoints([pose, pose])
        navigator.task = GoalTask("1" * 32)
        navigator.task.close(REACHED, "")
        ended = threading.Event()
        navigator.is_stopped = ended.is_set  # ends the wait of a test that would fail
        timer = threading.Timer(20.0, ended.set)
        timer.start()
        assert navigator.isTaskComplete()
        timer.cancel()
        assert not ended.is_set()
        assert navigator.getResult() == TaskResult.FAILED


def test_the_wait_for_an_initial_pose_can_be_stopped():
    with closing(Navigator.in_own_context()) as navigator:
        navigator.is_stopped = lambda: True
        pose, began = PoseStamped(), time.monotonic()
        pose.pose.orientation.w = 1.0
        assert not navigator.setInitialPose(pose, timeout=30.0)
        assert time.monotonic() - began < 20.0
