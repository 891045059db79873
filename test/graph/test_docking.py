"""Docking over DDS with three processes: faults of the detector, Nav2's actions, and which controller may drive."""

import math
import os
import random
from contextlib import ExitStack

import docks
import graph
import pytest
from action_msgs.msg import GoalStatus
from diagnostic_msgs.msg import DiagnosticStatus
from rcl_interfaces.srv import ListParameters
from rclpy.action import get_action_server_names_and_types_by_node
from repeated import tried
from robot import LATCHED, pose_stamped

from diffbot_control.ros.navigator import TaskResult
from diffbot_core.geometry import Pose, out_of_frame

DETECTED = {"use_dock_id": False, "navigate_to_staging_pose": False}
"""A goal of dock_robot for the dock that is detected."""
FAULTS = [pytest.param(one, marks=() if one == docks.SWAPPED else pytest.mark.slow) for one in docks.FAULTS]


@pytest.fixture(scope="module")
def scene(nav2_folder):
    with pytest.MonkeyPatch.context() as patch, ExitStack() as stack:
        patch.setenv("PYTHONPATH", os.pathsep.join(filter(None, (str(nav2_folder), os.environ.get("PYTHONPATH")))))
        running = docks.Scene(stack)
        running.peer = stack.enter_context(graph.peer())
        running.statuses = []
        running.navigator.create_subscription(DiagnosticStatus, "controller/status", running.statuses.append, LATCHED)
        yield running


def go_to(scene, x, y=0.0, yaw=0.0):
    assert scene.navigator.goToPose(pose_stamped(*out_of_frame(Pose(x, y, yaw), docks.DOCK)))


def drive_to(scene, x, y=0.0, yaw=0.0):
    go_to(scene, x, y, yaw)
    assert scene.wait() == "reached"


@tried(10)
@pytest.mark.parametrize("fault", FAULTS)
def test_a_robot_docks_exactly_or_reports_that_it_does_not(scene, fault, trials):
    chance, detector, navigator = random.Random(11), scene.detector, scene.navigator
    for _ in trials:
        go_to(scene, chance.uniform(-3.0, -0.9), chance.uniform(-0.5, 0.5), chance.uniform(-0.7, 0.7))
        scene.wait()
        detector.begin(fault)
        navigator.dock()
        end = scene.wait()
        detector.catch_up()
        contact = detector.contact
        detector.begin(docks.NONE)
        if contact is not None:
            assert abs(contact[0]) <= 0.02
            assert abs(contact[1]) <= math.radians(2.0)
        if fault != docks.NONE:
            assert end.startswith(("not reached: ", "pose lost: "))
            continue
        assert end == "reached"
        assert contact is not None
        assert navigator.undock()
        assert scene.wait() == "reached"


def test_the_actions_dock_at_the_second_try_after_a_false_contact_and_undock(scene, action_peer):
    drive_to(scene, -1.0, 0.05, 0.1)
    dock, undock = action_peer(scene.peer, "dock_robot"), action_peer(scene.peer, "undock_robot")

    def open_switch_after_first_try(feedback):
        if feedback.num_retries:
            scene.detector.touches = None

    scene.detector.touches = True
    status, result = dock.result(dock.send(open_switch_after_first_try, **DETECTED))
    assert (status, result.success, result.error_code) == (GoalStatus.STATUS_SUCCEEDED, True, 0), result
    assert result.num_retries >= 1
    assert result.error_msg == ""
    scene.detector.catch_up()
    assert abs(scene.detector.truth.x) < 0.05

    def times():
        return [one.docking_time.sec + 1e-9 * one.docking_time.nanosec for one in dock.feedback]

    # The robot drives at dock_speed, in simulated time. The result may arrive before the last feedback.
    scene.peer.spin_until(lambda: times() and times()[-1] > 0.6 / 0.12, what="the last feedback")
    assert times() == sorted(times())
    assert dock.feedback[-1].state == dock.type.Feedback.CONTROLLING

    status, result = undock.result(undock.send(max_undocking_time=1.0))
    assert (status, result.success, result.error_code) == (GoalStatus.STATUS_ABORTED, False, 905)
    assert result.error_msg == "not reached: not undocked within max_undocking_time = 1 s"

    status, result = undock.result(undock.send())
    assert (status, result.success, result.error_code) == (GoalStatus.STATUS_SUCCEEDED, True, 0), result
    scene.detector.catch_up()
    assert scene.detector.truth.x == pytest.approx(-0.7, abs=0.06)


def test_a_docking_is_cancelled_or_replaced_by_another(scene, action_peer):
    drive_to(scene, -3.0)  # so far that the robot does not dock before the cancellation
    dock, undock = action_peer(scene.peer, "dock_robot"), action_peer(scene.peer, "undock_robot")
    handle = dock.send(**DETECTED)
    scene.peer.spin_until(lambda: dock.feedback, what="feedback")
    assert dock.cancel(handle).goals_canceling
    status, result = dock.result(handle)
    assert (status, result.success) == (GoalStatus.STATUS_CANCELED, False)

    handle = dock.send(**DETECTED)
    scene.peer.spin_until(lambda: dock.feedback, what="feedback")
    newer = undock.send()
    status, result = dock.result(handle)
    assert (status, result.success, result.error_code) == (GoalStatus.STATUS_ABORTED, False, 999)
    assert result.error_msg == "replaced: by a newer goal (action)"
    undock.cancel(newer)
    undock.result(newer)
    # The new goal has also cancelled goals in map. After this call, the controller has answered that request, too.
    scene.peer.call(ListParameters, "controller/list_parameters")


def test_only_the_actions_of_docking_are_served_and_goals_that_cannot_be_served_are_rejected(scene, action_peer):
    for name, fields, reason in (
        ("dock_robot", {"navigate_to_staging_pose": False}, "use_dock_id is true: the node does not have a database"),
        ("dock_robot", {"use_dock_id": False}, "navigate_to_staging_pose is true: first drive"),
        ("undock_robot", {"max_undocking_time": 0.0}, "max_undocking_time is not positive: 0 s"),
    ):
        assert not action_peer(scene.peer, name).send(**fields).accepted
        assert f"{name}: goal rejected: {reason}" in scene.processes["docking"].output
    found = get_action_server_names_and_types_by_node(scene.peer.node, "dock_controller", "/")
    assert {name for name, _ in found} == {"/dock_robot", "/undock_robot"}
    in_map = get_action_server_names_and_types_by_node(scene.peer.node, "controller", "/")
    assert {name for name, _ in in_map} == {"/navigate_to_pose", "/navigate_through_poses", "/follow_path"}


def test_a_docking_cancels_the_goal_in_map_and_a_goal_in_map_cancels_the_docking(scene):
    navigator = scene.navigator
    drive_to(scene, -1.5)
    assert navigator.undock()  # the clients for docking find their controller, which detects its dock
    assert scene.wait() == "reached"
    assert navigator.spin_until(lambda: scene.statuses and scene.statuses[-1].message == "idle", 30.0)
    go_to(scene, -100.0)  # so far that the robot does not arrive before the docking begins, on a busy machine either
    drive = navigator.task
    assert navigator.spin_until(lambda: drive.feedback is not None, 30.0)
    assert navigator.dock()
    assert navigator.wait_for_end(60.0)
    assert drive.text == "cancelled: by a call of /controller/cancel from /dock_controller"
    docking = navigator._docking
    assert docking._restart_timeout == navigator._restart_timeout == graph.PATIENCE, "lost only after this time"
    go_to(scene, -1.5)
    assert docking.wait_for_end(60.0)
    assert docking.task.text == "cancelled: by a new goal of the controller in map"
    assert scene.wait() == "reached"
    assert navigator.getResult() == TaskResult.SUCCEEDED
