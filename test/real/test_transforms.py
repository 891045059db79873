"""tf2 finds the transforms at the stamps of the messages, in Python and C++, and transforms goals and a gyro."""

import math
import time

import graph
import one_process
import pytest
from filter_input import START, fix, odometry, timed
from nav_msgs.msg import Odometry
from overlay import program
from rclpy.action import ActionClient
from rclpy.time import Time
from robot import SIMULATED, planar, pose_stamped, robot, yaw
from sensor_msgs.msg import Imu
from tf2_msgs.action import LookupTransform
from tf2_ros import Buffer, TransformException, TransformListener

from diffbot_control.ekf_node import EkfNode

LOOKUPS = 1000
MAX_AGE = 5.0
"""[s] until a lookup fails"""
FAST = {"clock": "scaled", "real_time_factor": 2.0, "seed": 3}
FAR = (60.0, -60.0, 0.0)
MOUNT = (0.2, -0.1, 0.7)
"""Static transform of a sensor on the robot."""


@pytest.fixture(scope="module")
def driving():
    with robot(FAST, SIMULATED, SIMULATED, only=("robot", "plant")) as one:
        one.peer.spin_until(lambda: one.truths and one.poses, what="the first poses")
        one.send_goal(*FAR)
        yield one


class Stamps:
    """The received poses of the robot in odom and map, with their times of receipt."""

    def __init__(self, peer):
        self.waiting, self.begin = [], time.monotonic()
        for parent, topic in (("odom", "odom"), ("map", "odometry/filtered")):
            peer.node.create_subscription(Odometry, topic, lambda one, parent=parent: self._add(parent, one), 100)

    def _add(self, parent, message):
        self.waiting.append((time.monotonic(), parent, message))


def difference(transform, pose):
    there, (x, y, theta) = transform.translation, planar(pose)
    turn = math.remainder(yaw(transform.rotation) - theta, 2.0 * math.pi)
    return max(abs(there.x - x), abs(there.y - y), abs(turn))


def test_a_python_listener_finds_each_pose_at_its_stamp(driving, figures):
    peer, buffer = driving.peer, Buffer()
    TransformListener(buffer, peer.node)
    stamps, waits, errors = Stamps(peer), [], []

    def looked_up():
        left = []
        for at, parent, message in stamps.waiting:
            try:
                found = buffer.lookup_transform(parent, "base_link", Time.from_msg(message.header.stamp))
            except TransformException:
                assert time.monotonic() - at < MAX_AGE, f"{parent} to base_link at {message.header.stamp}"
                left.append((at, parent, message))
            else:
                waits.append(time.monotonic() - at)
                errors.append(difference(found.transform, message.pose.pose))
        stamps.waiting[:] = left
        return len(waits) >= LOOKUPS

    # Before the discovery of the listener, it does not receive transforms.
    peer.spin_until(lambda: buffer.can_transform("map", "base_link", Time()), what="the first transforms")
    stamps.waiting.clear()
    peer.spin_until(looked_up, 120.0, f"{LOOKUPS} transforms")
    assert max(errors) < 1e-9
    figures["tf2 python"] = {"lookups": len(waits), "worst wait": max(waits), "worst difference": max(errors)}


def test_a_cpp_listener_finds_each_pose_at_its_stamp(driving, figures):
    """tf2_ros's buffer_server waits in C++ for the transform of each stamp."""
    peer = driving.peer
    with program("tf2_ros", "buffer_server", "--ros-args", "-p", "buffer_size:=30.0"):
        client = ActionClient(peer.node, LookupTransform, "tf2_buffer_server")
        peer.spin_until(client.server_is_ready, what="the buffer server")
        graph.wait_for(lambda: not ask(peer, client, "map", Time().to_msg()).error.error, what="a transform at all")
        stamps, waits, errors = Stamps(peer), [], []
        while len(waits) < LOOKUPS:
            peer.spin_until(lambda: stamps.waiting, what="a pose")
            _, parent, message = stamps.waiting.pop(0)
            at = time.monotonic()
            result = ask(peer, client, parent, message.header.stamp)
            waits.append(time.monotonic() - at)
            assert result.error.error == 0, result.error.error_string
            errors.append(difference(result.transform.transform, message.pose.pose))
        client.destroy()
    assert max(errors) < 1e-9
    figures["tf2 c++"] = {"lookups": len(waits), "worst wait": max(waits), "worst difference": max(errors)}


def ask(peer, client, parent, stamp):
    """Return the server's answer for a stamp."""
    goal = LookupTransform.Goal(target_frame=parent, source_frame="base_link", source_time=stamp)
    goal.timeout.sec = int(MAX_AGE)
    sent = client.send_goal_async(goal)
    peer.spin_until(sent.done, what="the goal's acceptance")
    result = sent.result().get_result_async()
    peer.spin_until(result.done, what="the server's result")
    return result.result().result


@pytest.fixture
def mounted(driving):
    """Run a C++ node with a static transform, which is latched."""
    x, y, theta = MOUNT
    words = ("--x", x, "--y", y, "--yaw", theta, "--frame-id", "base_link", "--child-frame-id", "camera")
    with program("tf2_ros", "static_transform_publisher", *words) as publisher:
        publisher.wait_for_output("Spinning until stopped")
        yield driving


@pytest.mark.parametrize("frame", ["odom", "base_link", "camera"])
def test_a_goal_in_another_frame_is_transformed_to_map(mounted, frame):
    driving = mounted
    # At rest the transforms change only by the noise of the estimate.
    driving.cancel()
    driving.peer.spin_until(lambda: len(driving.truths) > 1 and at_rest(driving.truths), what="rest")
    driving.peer.wait_for_subscribers(driving.goals)
    goal, before = (2.0, 1.0, 0.5), driving.goal()

    def taken():
        # The controller does not know the frame before it has discovered the publisher of static transforms.
        driving.goals.publish(pose_stamped(*goal, frame=frame))
        return driving.peer.comes_true(lambda: driving.goal() not in (before, ()), 2.0)

    buffer = Buffer()
    TransformListener(buffer, driving.peer.node)
    driving.peer.spin_until(lambda: buffer.can_transform("map", frame, Time()), what="the transform")
    expected = in_map(buffer.lookup_transform("map", frame, Time()).transform, goal)
    graph.wait_for(taken, what=f"a goal of {frame}")
    found = driving.goal()
    assert found[:2] == pytest.approx(expected[:2], abs=0.3)
    assert math.remainder(found[2] - expected[2], 2.0 * math.pi) == pytest.approx(0.0, abs=0.2)


def at_rest(truths):
    twist = truths[-1].twist.twist
    return abs(twist.linear.x) + abs(twist.angular.z) < 1e-6


def in_map(transform, pose):
    turn = yaw(transform.rotation)
    x = transform.translation.x + pose[0] * math.cos(turn) - pose[1] * math.sin(turn)
    y = transform.translation.y + pose[0] * math.sin(turn) + pose[1] * math.cos(turn)
    return x, y, pose[2] + turn


def upside_down(time, rate):
    """Return the measurement of a gyro that is mounted upside down, at a turn rate of the robot [rad/s]."""
    message = timed(Imu(), time)
    message.header.frame_id = "imu_link"
    message.angular_velocity.z = -rate
    message.angular_velocity_covariance[[0, 4, 8]] = 2.5e-5
    return message


@pytest.mark.parametrize("is_known", [True, False])
def test_a_gyro_upside_down_agrees_with_the_wheels_only_with_its_transform(is_known):
    frame = "imu_link" if is_known else "elsewhere"
    words = ("--roll", math.pi, "--frame-id", "base_link", "--child-frame-id", frame)
    with one_process.nodes() as nodes, program("tf2_ros", "static_transform_publisher", *words) as publisher:
        publisher.wait_for_output("Spinning until stopped")
        fed = one_process.Fed(nodes, EkfNode, {"use_gyro": True, "sensor_timeout": 600.0, "reliable_inputs": True})
        buffer = Buffer()
        TransformListener(buffer, nodes.peer.node)
        nodes.peer.spin_until(lambda: buffer.can_transform("base_link", frame, Time()), what="the transform")
        fed.send("global_pose", fix())
        for step in range(1, 60):
            fed.send("imu", upside_down(START + 0.1 * step, 0.8))
            fed.send("odom", odometry(START + 0.1 * step, omega=0.8))
        fed.node._check_and_report()
        _, text = fed.node.health_level()
    assert ("turn rates of imu and odom have opposite signs" in text) == (not is_known), text
