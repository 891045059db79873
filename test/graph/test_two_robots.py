"""Two robots in one graph."""

from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped, TwistStamped
from nav_msgs.msg import Odometry
from robot import DEEP, pose_stamped
from sensor_msgs.msg import Imu

from diffbot_control.controller_node import ControllerNode
from diffbot_control.ekf_node import EkfNode
from diffbot_sim.plant_node import PlantNode

TOPICS = {
    "odom": (Odometry, "{}/odom", "{}/base_link"),
    "odometry/filtered": (Odometry, "map", "{}/base_link"),
    "ground_truth": (Odometry, "map", "{}/base_link"),
    "pose": (PoseWithCovarianceStamped, "map", ""),
    "global_pose": (PoseWithCovarianceStamped, "map", ""),
    "heading": (Imu, "{}/base_link", ""),
    "cmd_vel": (TwistStamped, "{}/base_link", ""),
}
"""Type, frame and child frame, with the robot's name in them."""


def add_robot(nodes, name, plant):
    """Add plant, filter and controller under ``/name`` with the frame prefix ``name/``."""
    arguments, frames = ("-r", f"__ns:=/{name}"), {"frame_prefix": f"{name}/"}
    nodes.add(EkfNode, frames, arguments)
    controller = nodes.add(ControllerNode, {**frames, "cmd_vel_type": "twist_stamped"}, arguments)
    nodes.add(PlantNode, {"cmd_vel_type": "twist_stamped", **frames, **plant}, arguments)
    return controller


def go(peer, name, *goal):
    goals = peer.publisher(PoseStamped, f"/{name}/goal_pose")
    peer.wait_for_subscribers(goals)
    goals.publish(pose_stamped(*goal))


def test_two_robots_in_namespaces_share_neither_topics_nor_frames(nodes):
    peer = nodes.peer
    # rclpy keeps some publishers, such as ~/transition_event, of nodes of other tests until the process ends.
    before = {name for name, _ in peer.node.get_topic_names_and_types()}
    received = {
        name: {topic: peer.subscribe(kind, f"/{name}/{topic}", DEEP) for topic, (kind, *_) in TOPICS.items()}
        for name in ("left", "right")
    }
    plant = {"heading_rate": 10.0, **{f"initial_pose.{name}": 0.0 for name in ("x", "y", "yaw")}}
    controllers = {name: add_robot(nodes, name, plant) for name in received}
    go(peer, "left", 0.4, 0.0, 0.0)
    peer.spin_until(lambda: controllers["left"].supervisor.goals_reached == 1, what="the left robot at its goal")
    peer.spin_until(lambda: all(received["right"][one] for one in ("pose", "heading")), what="poses of the right one")
    assert not received["right"]["cmd_vel"], "the left robot's goal is not the right one's"
    for name, topics in received.items():
        for topic, messages in topics.items():
            found = {(one.header.frame_id, getattr(one, "child_frame_id", "")) for one in messages}
            assert found <= {tuple(frame.format(name) for frame in TOPICS[topic][1:])}, (name, topic)
        assert not controllers[name].health.dropped
    heading = received["left"]["heading"][0]
    assert heading.angular_velocity_covariance[0] == heading.linear_acceleration_covariance[0] == -1.0
    absolute = {"/diagnostics", "/parameter_events", "/rosout", "/tf", "/tf_static", "/clock"}
    names = {name for name, _ in peer.node.get_topic_names_and_types()} - absolute - before
    assert {name.split("/")[1] for name in names} == {"left", "right"}
