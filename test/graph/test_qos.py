"""Quality of service: inputs from any publisher, outputs for every subscriber, and a stop that is not lost."""

import sys
from pathlib import Path

import graph
import one_process
import pytest
from filter_input import START, fix, heading, joint_state, odometry
from geometry_msgs.msg import Twist
from nav_msgs.msg import Odometry
from rclpy.qos import QoSProfile, ReliabilityPolicy
from robot import pose_stamped
from sensor_msgs.msg import PointCloud2

from diffbot_control.controller_node import ControllerNode
from diffbot_control.ekf_node import EkfNode
from diffbot_sim.plant_node import PlantNode

BEST_EFFORT = QoSProfile(depth=5, reliability=ReliabilityPolicy.BEST_EFFORT)
RELIABLE = QoSProfile(depth=10)
LANDMARKS = {"landmark_ids": [7], "landmark_x": [3.0], "landmark_y": [2.0]}
CASES = [
    (
        EkfNode,
        LANDMARKS,
        (odometry(START), fix(), heading(), PointCloud2()),
        ("odom", "global_pose", "heading", "landmarks"),
    ),
    (EkfNode, {"odometry_source": "joint_states"}, (joint_state(START),), ("joint_states",)),
    (ControllerNode, {}, (fix(),), ("pose",)),
    (ControllerNode, {"pose_source": "odometry"}, (odometry(START),), ("odometry/filtered",)),
]
OUTPUTS = {
    # RViz2, Nav2 and robot_localization request reliable delivery of these.
    **dict.fromkeys(
        ("cmd_vel", "pose", "odometry/filtered", "odom", "global_pose", "heading"), ("RELIABLE", "VOLATILE")
    ),
    **dict.fromkeys(("ekf/status", "controller/status"), ("RELIABLE", "TRANSIENT_LOCAL")),
}


@pytest.mark.parametrize(("kind", "parameters", "messages", "topics"), CASES, ids=[case[3][0] for case in CASES])
def test_sensors_are_received_from_best_effort_and_from_reliable_publishers(nodes, kind, parameters, messages, topics):
    fed = one_process.Fed(nodes, kind, parameters)
    for message, topic in zip(messages, topics, strict=True):
        for count, qos in enumerate((BEST_EFFORT, RELIABLE), 1):
            publisher = nodes.peer.publisher(type(message), topic, qos)
            nodes.peer.wait_for_subscribers(publisher)
            publisher.publish(message)
            nodes.peer.spin_until(lambda: fed.handled(topic) == count, what=f"message {count} on {topic}")  # noqa: B023
            nodes.peer.node.destroy_publisher(publisher)


def test_reliable_inputs_do_not_receive_from_best_effort_publishers(nodes):
    fed = one_process.Fed(nodes, EkfNode, {"reliable_inputs": True})
    weak = nodes.peer.publisher(Odometry, "odom", BEST_EFFORT)
    fed.send("odom", odometry(START))
    assert weak.get_subscription_count() == 0


def test_publishers_offer_what_rviz_nav2_and_robot_localization_request_unless_overridden(nodes):
    overrides = {
        "qos_overrides./r7/odom.subscription.reliability": "reliable",
        "qos_overrides./r7/pose.publisher.reliability": "best_effort",
    }
    for kind, parameters in ((EkfNode, {}), (ControllerNode, {}), (PlantNode, {"start_paused": True})):
        nodes.add(kind, parameters)
    nodes.add(EkfNode, overrides, ("-r", "__ns:=/r7"))

    def profile(topic, find=nodes.peer.node.get_publishers_info_by_topic):
        (info,) = nodes.peer.spin_until(lambda: find(topic), what=f"an end of {topic}")
        return info.qos_profile.reliability.name, info.qos_profile.durability.name

    assert {topic: profile(f"/{topic}") for topic in OUTPUTS} == OUTPUTS
    assert profile("/r7/pose")[0] == "BEST_EFFORT"
    subscriptions = nodes.peer.node.get_subscriptions_info_by_topic
    assert profile("/r7/odom", subscriptions)[0] == "RELIABLE"
    assert profile("/r7/heading", subscriptions)[0] == "BEST_EFFORT"


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
