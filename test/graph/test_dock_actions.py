"""Nav2's actions of docking, with the real interface and rclpy's ActionClient: ends, retries, refusals, cancelling."""

import os
from contextlib import ExitStack

import docks
import pytest
import rclpy
from action_msgs.msg import GoalStatus
from graph import PATIENCE, peer, private_domain
from rclpy.action import get_action_server_names_and_types_by_node
from rclpy.duration import Duration
from robot import pose_stamped
from sensor_msgs.msg import BatteryState
from std_msgs.msg import Bool

from diffbot_core.geometry import Pose, out_of_frame

pytestmark = pytest.mark.graph
SEEN = {"use_dock_id": False, "navigate_to_staging_pose": False}
"""A goal of dock_robot for the dock that is detected."""


@pytest.fixture(scope="module")
def scene(nav2_folder):
    """The nodes, which find nav2_msgs; the robot stands before its dock."""
    with private_domain(), pytest.MonkeyPatch.context() as patch, ExitStack() as stack:
        patch.setenv("PYTHONPATH", os.pathsep.join(filter(None, (str(nav2_folder), os.environ.get("PYTHONPATH")))))
        rclpy.init()
        stack.callback(rclpy.try_shutdown)
        running = stack.enter_context(docks.Scene(seed=5, contact_topic="contact_of_plant"))
        running.peer = stack.enter_context(peer())
        running.touches = None
        switch = running.peer.publisher(Bool, "dock_contact")
        running.peer.wait_for_subscribers(switch)

        def relay(message):
            switch.publish(message if running.touches is None else Bool(data=running.touches))

        running.peer.node.create_subscription(Bool, "contact_of_plant", relay, 10)
        yield running


@pytest.fixture
def staged(scene):
    """The scene, with the robot at its staging pose."""
    return stage(scene, -1.0)


def stage(scene, x):
    assert scene.navigator.goToPose(pose_stamped(*out_of_frame(Pose(x, 0.05, 0.1), docks.DOCK)))
    assert scene.wait() == "reached"
    return scene


def test_a_robot_that_touches_something_before_its_dock_gives_up_after_its_tries(staged, action_peer):
    dock = action_peer(staged.peer, "dock_robot")
    staged.touches = True
    status, result = dock.result(dock.send(**SEEN))
    staged.touches = None
    assert (status, result.success, result.error_code) == (GoalStatus.STATUS_ABORTED, False, 905)
    assert result.error_msg.startswith("not reached: 3 approaches broken off")
    assert result.num_retries == 3


def test_a_docked_robot_whose_battery_is_full_does_not_leave_its_dock_to_dock_again(staged, action_peer):
    dock = action_peer(staged.peer, "dock_robot")
    battery = staged.peer.publisher(BatteryState, "battery_state")
    staged.peer.wait_for_subscribers(battery)
    assert dock.result(dock.send(**SEEN))[0] == GoalStatus.STATUS_SUCCEEDED
    battery.publish(BatteryState(power_supply_status=BatteryState.POWER_SUPPLY_STATUS_FULL))
    assert battery.wait_for_all_acked(Duration(seconds=PATIENCE))
    places = []
    answer = dock.result(dock.send(lambda _: places.append(staged.detector.truth.x), **SEEN))
    places.append(staged.detector.truth.x)
    battery.publish(BatteryState(power_supply_status=BatteryState.POWER_SUPPLY_STATUS_DISCHARGING))
    assert answer[0] == GoalStatus.STATUS_SUCCEEDED
    assert min(places) > -0.05


def test_the_robot_docks_and_undocks(staged, action_peer):
    dock, undock = action_peer(staged.peer, "dock_robot"), action_peer(staged.peer, "undock_robot")
    status, result = dock.result(dock.send(**SEEN))
    assert (status, result.success, result.error_code) == (GoalStatus.STATUS_SUCCEEDED, True, 0), result
    assert (result.num_retries, result.error_msg) == (0, "")
    staged.detector.catch_up()
    assert abs(staged.detector.truth.x) < 0.05

    def times():
        return [one.docking_time.sec + 1e-9 * one.docking_time.nanosec for one in dock.feedback]

    # Almost the whole way at dock_speed, in simulated time. The result may overtake it.
    staged.peer.spin_until(lambda: times() and times()[-1] > 0.6 / 0.12, what="the last feedback")
    assert times() == sorted(times())
    assert dock.feedback[-1].state == dock.type.Feedback.CONTROLLING

    status, result = undock.result(undock.send(max_undocking_time=1.0))
    assert (status, result.success, result.error_code) == (GoalStatus.STATUS_ABORTED, False, 905)
    assert result.error_msg == "not reached: not undocked within max_undocking_time = 1 s"

    status, result = undock.result(undock.send())
    assert (status, result.success, result.error_code) == (GoalStatus.STATUS_SUCCEEDED, True, 0), result
    staged.detector.catch_up()
    assert staged.detector.truth.x == pytest.approx(-0.7, abs=0.06)


def test_a_docking_is_cancelled_and_another_replaced(scene, action_peer):
    staged = stage(scene, -3.0)  # so far that it is not docked before the cancellation
    dock, undock = action_peer(staged.peer, "dock_robot"), action_peer(staged.peer, "undock_robot")
    handle = dock.send(**SEEN)
    staged.peer.spin_until(lambda: dock.feedback, what="feedback")
    assert dock.cancel(handle).goals_canceling
    status, result = dock.result(handle)
    assert (status, result.success) == (GoalStatus.STATUS_CANCELED, False)

    handle = dock.send(**SEEN)
    staged.peer.spin_until(lambda: dock.feedback, what="feedback")
    newer = undock.send()
    status, result = dock.result(handle)
    assert (status, result.success, result.error_code) == (GoalStatus.STATUS_ABORTED, False, 999)
    assert result.error_msg == "replaced: by a newer goal (action)"
    assert undock.result(newer)[0] in (GoalStatus.STATUS_SUCCEEDED, GoalStatus.STATUS_ABORTED)


@pytest.mark.parametrize(
    ("name", "fields", "reason"),
    [
        ("dock_robot", {"navigate_to_staging_pose": False}, "use_dock_id is true: the node does not have a database"),
        ("dock_robot", {"use_dock_id": False}, "navigate_to_staging_pose is true: first drive"),
        ("undock_robot", {"max_undocking_time": 0.0}, "max_undocking_time is not positive: 0 s"),
    ],
)
def test_a_goal_that_cannot_be_served_is_rejected_with_a_reason(scene, action_peer, name, fields, reason):
    assert not action_peer(scene.peer, name).send(**fields).accepted
    assert f"{name}: goal rejected: {reason}" in scene.processes["docking"].output


def test_a_node_that_docks_serves_no_other_action(scene, action_peer):
    action_peer(scene.peer, "dock_robot")
    found = get_action_server_names_and_types_by_node(scene.peer.node, "dock_controller", "/")
    assert {name for name, _ in found} == {"/dock_robot", "/undock_robot"}
    in_map = get_action_server_names_and_types_by_node(scene.peer.node, "controller", "/")
    assert {name for name, _ in in_map} == {"/navigate_to_pose", "/navigate_through_poses", "/follow_path"}
