"""Quality of service: inputs from any publisher, outputs for every subscriber, and a stop that is not lost."""

import sys
from pathlib import Path

import graph
import one_process
import pytest
from filter_input import fix
from geometry_msgs.msg import Twist
from rclpy.qos import QoSProfile, ReliabilityPolicy
from robot import pose_stamped

from diffbot_control.controller_node import ControllerNode
from diffbot_control.ekf_node import EkfNode
from diffbot_sim.plant_node import PlantNode

BEST_EFFORT = QoSProfile(depth=5, reliability=ReliabilityPolicy.BEST_EFFORT)
RELIABLE = QoSProfile(depth=10)
ALL_INPUTS = {
    EkfNode: {"landmark_ids": [7], "landmark_x": [3.0], "landmark_y": [2.0], "use_gyro": True},
    ControllerNode: {},
    PlantNode: {"start_paused": True},
}
OTHER_INPUTS = {EkfNode: {"odometry_source": "joint_states"}, ControllerNode: {"pose_source": "odometry"}}
SENSORS = (
    *("odom", "joint_states", "global_pose", "heading", "imu", "landmarks", "pose", "odometry/filtered"),
    "battery_state",
)
RELIABLE_OUTPUTS = ("cmd_vel", "pose", "odometry/filtered", "odom", "global_pose", "heading")
"""RViz2, Nav2 and robot_localization request reliable delivery of these."""
LATCHED_OUTPUTS = ("ekf/status", "controller/status", "controller/goal_status", "controller/goal_results")


def test_nodes_receive_from_any_publisher_and_offer_what_other_nodes_request_unless_overridden(nodes):
    """A best-effort subscription receives from best-effort and from reliable publishers."""
    overrides = {
        "qos_overrides./r7/odom.subscription.reliability": "reliable",
        "qos_overrides./r7/pose.publisher.reliability": "best_effort",
    }
    for kind, parameters in ALL_INPUTS.items():
        nodes.add(kind, parameters)
    for kind, parameters in OTHER_INPUTS.items():
        nodes.add(kind, parameters, ("-r", "__node:=other"))
    nodes.add(EkfNode, overrides, ("-r", "__ns:=/r7"))
    nodes.add(EkfNode, {"reliable_inputs": True}, ("-r", "__ns:=/r8"))
    peer = nodes.peer.node

    def profiles(topic, find):
        infos = nodes.peer.spin_until(lambda: find(topic), what=f"an end of {topic}")
        return {(info.qos_profile.reliability.name, info.qos_profile.durability.name) for info in infos}

    subscriptions, publishers = peer.get_subscriptions_info_by_topic, peer.get_publishers_info_by_topic
    for topic in SENSORS:
        assert profiles(f"/{topic}", subscriptions) == {("BEST_EFFORT", "VOLATILE")}, topic
    for topic in RELIABLE_OUTPUTS:
        assert profiles(f"/{topic}", publishers) == {("RELIABLE", "VOLATILE")}, topic
    for topic in LATCHED_OUTPUTS:
        assert profiles(f"/{topic}", publishers) == {("RELIABLE", "TRANSIENT_LOCAL")}, topic
    assert profiles("/r7/pose", publishers) == {("BEST_EFFORT", "VOLATILE")}
    assert profiles("/r7/odom", subscriptions) == {("RELIABLE", "VOLATILE")}
    assert profiles("/r7/heading", subscriptions) == {("BEST_EFFORT", "VOLATILE")}
    assert profiles("/r8/odom", subscriptions) == {("RELIABLE", "VOLATILE")}


@pytest.mark.parametrize(("qos", "zeros"), [(RELIABLE, 1), (BEST_EFFORT, 3)])
def test_the_stop_at_the_end_is_repeated_if_the_subscriber_does_not_acknowledge(nodes, qos, zeros, monkeypatch):
    monkeypatch.setattr("diffbot_core.ros.qos.DELIVERY_TIMEOUT", graph.PATIENCE)
    fed = one_process.Fed(nodes, ControllerNode, {"pose_timeout": 60.0})
    commands = nodes.peer.subscribe(Twist, "cmd_vel", qos)
    fed.send("goal_pose", pose_stamped(5.0, 0.0, 0.0))
    fed.send("pose", fix())
    nodes.peer.spin_until(lambda: commands, what="a command")
    fed.node.before_shutdown()
    nodes.remove(fed.node)
    nodes.peer.spin_until(lambda: commands.count(Twist()) >= zeros, what="the stop")


def test_a_node_that_drives_has_no_shared_memory_that_a_dying_neighbour_could_block():
    # Within this machine alone, but with the transports of nodes on several machines.
    environment = graph.environment(ROS_AUTOMATIC_DISCOVERY_RANGE="OFF")
    del environment["FASTRTPS_DEFAULT_PROFILES_FILE"]
    with graph.process(sys.executable, "-P", "-m", "diffbot_control.robot_node", env=environment) as process:
        process.wait_for_output("ready")
        assert "/dev/shm/fastrtps" not in Path(f"/proc/{process.popen.pid}/maps").read_text()
