"""Quality of service: every sensor is received from best-effort and reliable publishers, and a loss is survived."""

import one_process
import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from filter_input import START, fix, heading, joint_state, odometry
from lossy_drives import LOSS, drive, goals
from lossy_relay import BEST_EFFORT
from nav_msgs.msg import Odometry
from rclpy.qos import QoSProfile
from robot import LATCHED, distance, turned
from sensor_msgs.msg import PointCloud2

from diffbot_control.controller_node import ControllerNode
from diffbot_control.ekf_node import EkfNode
from diffbot_sim.plant_node import PlantNode

RELIABLE = QoSProfile(depth=10)
LANDMARKS = {"landmark_ids": [7], "landmark_x": [3.0], "landmark_y": [2.0]}


def cloud():
    message = PointCloud2()
    message.header.frame_id = "base_link"
    return message


def filtered():
    message = odometry(START)
    message.header.frame_id = "map"
    return message


CASES = [
    (EkfNode, {}, "odom", lambda: odometry(START)),
    (EkfNode, {"odometry_source": "joint_states"}, "joint_states", lambda: joint_state(START)),
    (EkfNode, {}, "global_pose", fix),
    (EkfNode, {}, "heading", heading),
    (EkfNode, LANDMARKS, "landmarks", cloud),
    (ControllerNode, {}, "pose", fix),
    (ControllerNode, {"pose_source": "odometry"}, "odometry/filtered", filtered),
]


@pytest.fixture
def nodes():
    """A context for each test: what a node has published stays listed as long as an executor holds its handles."""
    with one_process.nodes() as running:
        yield running


def received(node, topic):
    """Messages that came, good or bad."""
    return node.health.accepted[topic] + sum(count for (name, _), count in node.health.dropped.items() if name == topic)


@pytest.mark.parametrize(("kind", "parameters", "topic", "message"), CASES, ids=[case[2] for case in CASES])
def test_sensors_are_received_from_best_effort_and_from_reliable_publishers(nodes, kind, parameters, topic, message):
    node = nodes.add(kind, parameters)
    for count, qos in enumerate((BEST_EFFORT, RELIABLE), 1):
        publisher = nodes.peer.publisher(type(message()), topic, qos)
        nodes.peer.wait_for_subscribers(publisher)
        publisher.publish(message())
        nodes.peer.spin_until(lambda count=count: received(node, topic) == count, 3.0, f"message {count}")
        nodes.peer.node.destroy_publisher(publisher)
    nodes.remove(node)


def test_reliable_inputs_shut_best_effort_publishers_out(nodes):
    node = nodes.add(EkfNode, {"reliable_inputs": True})
    weak, strong = (nodes.peer.publisher(Odometry, "odom", qos) for qos in (BEST_EFFORT, RELIABLE))
    nodes.peer.wait_for_subscribers(strong)
    strong.publish(odometry(START))
    nodes.peer.spin_until(lambda: received(node, "odom") == 1, 3.0, "the message")
    assert weak.get_subscription_count() == 0
    nodes.remove(node)


OUTPUTS = {
    # RViz2, Nav2 and robot_localization ask for reliable delivery of these.
    **dict.fromkeys(
        ("cmd_vel", "pose", "odometry/filtered", "odom", "global_pose", "heading"), ("RELIABLE", "VOLATILE")
    ),
    **dict.fromkeys(("ekf/status", "controller/status"), ("RELIABLE", "TRANSIENT_LOCAL")),
}


def test_publishers_offer_what_rviz_nav2_and_robot_localization_ask_for(nodes):
    for kind, parameters in ((EkfNode, {}), (ControllerNode, {}), (PlantNode, {"start_paused": True})):
        nodes.add(kind, parameters)
    for topic, expected in OUTPUTS.items():

        def found(topic=topic):
            infos = nodes.peer.node.get_publishers_info_by_topic(f"/{topic}")
            return [one for one in infos if one.node_name in ("ekf", "controller", "plant")]

        nodes.peer.spin_until(lambda found=found: len(found()) == 1, 30.0, f"one publisher of {topic}")
        (info,) = found()
        assert (info.qos_profile.reliability.name, info.qos_profile.durability.name) == expected, topic
    late = nodes.peer.subscribe(DiagnosticStatus, "ekf/status", LATCHED)
    nodes.peer.spin_until(lambda: late, 3.0, "the latched status")


def test_a_goal_is_reached_with_a_fifth_of_odometry_and_fixes_lost():
    (end,), running = drive(1)
    assert distance(end, goals(1)[0]) < 0.3
    assert turned(end, goals(1)[0]) < 0.2
    for relay in (running.odometry, running.fixes):
        assert relay.lost / (relay.lost + relay.passed) == pytest.approx(LOSS, abs=0.1)
    assert running.ekf.health.accepted["odom"] < 0.9 * (running.odometry.lost + running.odometry.passed)
