"""The transform map -> odom of the ekf, with odometry from odom and from joint_states."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
from filter_input import START, fix, joint_state, odometry
from robot import pose_stamped

from diffbot_control import ekf_node
from diffbot_control.ekf_node import EkfNode
from diffbot_control.filter.models import WHEELS
from diffbot_control.filter.state import set_errors
from diffbot_control.ros import tf
from diffbot_control.ros.messages import conversions as messages
from diffbot_control.ros.tf import TransformSender
from diffbot_core.geometry import Pose

SECOND = 10**9


class Node:
    def __init__(self):
        self.sent = []

    def create_publisher(self, _kind, *arguments):
        self.arguments = arguments
        return SimpleNamespace(publish=self.sent.append)


def matrix(pose):
    c, s = math.cos(pose[2]), math.sin(pose[2])
    return np.array([[c, -s, pose[0]], [s, c, pose[1]], [0.0, 0.0, 1.0]])


def test_map_to_odom_transforms_the_pose_in_odom_to_the_estimate(monkeypatch):
    # No wheel has tf2_msgs.
    monkeypatch.setattr(messages, "TFMessage", SimpleNamespace)
    node = Node()
    in_map, in_odom = Pose(3.0, -2.0, 2.5), Pose(1.0, 4.0, -1.5)
    TransformSender(node, "map", "left/odom", 0.25).send(7 * SECOND, in_map, in_odom)
    (stamped,) = node.sent[0].transforms
    assert (stamped.header.frame_id, stamped.child_frame_id) == ("map", "left/odom")
    assert (stamped.header.stamp.sec, stamped.header.stamp.nanosec) == (7, 250_000_000)
    t, q = stamped.transform.translation, stamped.transform.rotation
    sent = matrix((t.x, t.y, 2.0 * math.atan2(q.z, q.w)))
    np.testing.assert_allclose(sent @ matrix(in_odom), matrix(in_map), atol=1e-12)
    assert node.arguments == ("/tf", tf.TRANSFORMS)


@pytest.fixture
def ekf(nodes, monkeypatch):
    """Return a function that starts an ekf and returns it with the arguments and the transforms of its sender."""
    created, sent = [], []

    def sender(*arguments):
        created[:] = arguments
        return SimpleNamespace(send=lambda *values: sent.append(values))

    monkeypatch.setattr(ekf_node, "transform_sender", sender)
    return lambda parameters: (nodes.add(EkfNode, parameters), created, sent)


def in_odom(time, x, y, theta, prefix=""):
    message = odometry(time)
    message.child_frame_id = f"{prefix}base_link"
    message.pose.pose = pose_stamped(x, y, theta).pose
    return message


def test_with_odom_the_transform_has_the_stamp_and_the_pose_of_the_message(ekf):
    node, created, sent = ekf({"frame_prefix": "left/", "transform_tolerance": 0.5})
    assert tuple(created[1:]) == ("map", "left/odom", 0.5)
    node._on_sensor("global_pose", fix(START, 1.0, 2.0, 0.5))
    node._on_odometry(in_odom(START, 5.0, 6.0, 0.1, "left/"))
    ((stamp, estimate, own),) = sent
    assert stamp == round(START * SECOND)
    assert estimate == pytest.approx((1.0, 2.0, 0.5), abs=1e-6)
    assert own == pytest.approx((5.0, 6.0, 0.1), abs=1e-12)


@pytest.mark.parametrize("late", [0.05, -0.05])
def test_with_joint_states_the_estimate_is_predicted_to_the_stamp_of_odom_by_the_corrected_twist(ekf, late):
    parameters = {"odometry_source": "joint_states", "sensor_timeout": 1.0, "wheels_as_configured": 0.0}
    node, _, sent = ekf(parameters)
    node._on_odometry_pose(in_odom(START, 5.0, 6.0, 0.1))
    assert not sent, "no estimate yet"
    node._on_sensor("global_pose", fix(START, 1.0, 2.0, 0.0))
    # Both wheels, which have a radius of 0.05 m and turn at 10 rad/s, are known to be 2 % too large: 0.51 m/s.
    of_wheels = WHEELS, np.array([0.02, 0.02, 0.0]), np.diag([1e-8] * 3)
    set_errors(node.localization.filter, node.localization.options, *of_wheels)
    node._on_joint_states(joint_state(START, 10.0, 10.0))
    node._on_odometry_pose(in_odom(START + 1.5, 5.0, 6.0, 0.1))
    assert not sent, "too far from the newest estimate"
    node._on_odometry_pose(in_odom(START + late, 5.0, 6.0, 0.1))
    ((stamp, estimate, own),) = sent
    assert stamp == round((START + late) * SECOND)
    assert estimate == pytest.approx((1.0 + 0.51 * late, 2.0, 0.0), abs=1e-6)
    assert own == pytest.approx((5.0, 6.0, 0.1), abs=1e-12)


@pytest.mark.parametrize(("source", "publishes"), [("odom", True), ("joint_states", True), ("odom", False)])
def test_odom_in_another_frame_is_reported_if_the_transform_is_published(ekf, monkeypatch, source, publishes):
    if not publishes:
        monkeypatch.setattr(ekf_node, "transform_sender", lambda *_: None)  # as without tf2_msgs
    node, _, _ = ekf({"odometry_source": source, "odom_frame": "wheel_odom"})
    node._on_sensor("global_pose", fix(START, 1.0, 2.0, 0.0))
    receive = node._on_odometry if source == "odom" else node._on_odometry_pose
    receive(in_odom(START, 5.0, 6.0, 0.1))
    node._check_and_report()
    assert ("odom has the frame_id 'odom'" in node.health_level()[1]) == publishes


@pytest.mark.parametrize("source", ["odom", "joint_states"])
def test_a_deactivated_ekf_sends_nothing(ekf, source):
    node, _, sent = ekf({"odometry_source": source})
    node._on_sensor("global_pose", fix(START, 1.0, 2.0, 0.0))

    def move(time):
        if source == "joint_states":
            node._on_joint_states(joint_state(time, 10.0, 10.0))
            node._on_odometry_pose(in_odom(time, 5.0, 6.0, 0.1))
        else:
            node._on_odometry(in_odom(time, 5.0, 6.0, 0.1))
        return len(sent)

    assert move(START) == 1
    node.trigger_deactivate()
    assert move(START + 0.1) == 1
    node.trigger_activate()
    assert move(START + 0.2) == 2
