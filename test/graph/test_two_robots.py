"""Two robots in one graph: topics and frames apart, one clock for both, and what two clocks do."""

import graph
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped, TwistStamped
from nav_msgs.msg import Odometry
from robot import DEEP, pose_stamped
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import Imu

from diffbot_control.controller_node import ControllerNode
from diffbot_control.ekf_node import EkfNode
from diffbot_core.ros.node import DiffbotNode
from diffbot_sim.parameters import PlantNodeConfig
from diffbot_sim.plant_node import PlantNode

SIMULATED = {"use_sim_time": True}
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


def test_topics_and_frames_of_two_robots_are_apart(nodes):
    """One goes to its goal, the other one receives nothing of it."""
    peer = nodes.peer
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
    names = {name for name, _ in peer.node.get_topic_names_and_types()} - absolute
    # rclpy keeps this publisher of a lifecycle node until the process ends, here that of other tests.
    assert {name.split("/")[1] for name in names if not name.endswith("/transition_event")} == {"left", "right"}


class Listener(DiffbotNode):
    """A node with use_sim_time and nothing else."""

    def __init__(self, **options):
        super().__init__("listener", PlantNodeConfig, **options)


def test_a_missing_clock_is_reported_and_its_coming_too(nodes, capfd):
    peer = nodes.peer
    reports = peer.subscribe(DiagnosticArray, "/diagnostics", DEEP)
    nodes.add(Listener, SIMULATED)
    text = "use_sim_time is set, but nothing publishes /clock: time stands still"

    def newest():
        found = [one for array in reports for one in array.status if one.name == "/listener"]
        return (found[-1].level, found[-1].message) if found else None

    peer.spin_until(lambda: newest() == (b"\x01", text), what="the report")
    assert "".join(capfd.readouterr()).count(text) == 1
    peer.wait_for_subscribers(peer.publisher(Clock, "/clock"))
    peer.spin_until(lambda: newest() == (b"\x00", "ok"), what="the all-clear")


def test_time_that_jumps_to_and_fro_from_one_publisher_is_an_error_and_now_runs_on(nodes, monkeypatch):
    """As of a bridge that passes on two clocks."""
    for name in ("_WINDOW", "_SETTLE"):
        monkeypatch.setattr(f"diffbot_core.ros.watches.{name}", graph.PATIENCE)
    peer = nodes.peer
    node = nodes.add(Listener, SIMULATED)
    publisher = peer.publisher(Clock, "/clock")
    peer.wait_for_subscribers(publisher)

    def tell(seconds):
        message = Clock()
        message.clock.sec = seconds
        publisher.publish(message)
        peer.spin_until(lambda: node.get_clock().now().nanoseconds == seconds * 10**9, what=f"the time {seconds} s")
        return node.clock_watch.now()

    assert tell(100) == 100.0
    assert tell(101) == 101.0
    assert tell(20) == 20.0, "one jump back is a simulation that was started again"
    assert node.clock_watch.problem == "time on /clock jumped back"
    assert not node.clock_watch.contradictory
    readings = [tell(seconds) for seconds in (500, 21, 501, 22, 502, 23, 503)]
    assert node.clock_watch.contradictory
    assert "jumps to and fro" in node.clock_watch.problem
    assert node.health_level()[0] == 2
    assert readings[-4:] == sorted(readings[-4:])
    # By the real time between them, not by the jumps of 480 s.
    assert readings[-1] - readings[-4] < 240.0
