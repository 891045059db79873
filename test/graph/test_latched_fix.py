"""A fix that was latched before the ekf starts, as AMCL's, which publishes again after a motion only."""

import time

import one_process
import pytest
from filter_input import fix, odometry
from geometry_msgs.msg import PoseWithCovarianceStamped
from robot import LATCHED
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger

from diffbot_control.ekf_node import EkfNode


class LateFilter(one_process.Fed):
    """An ekf that starts after the fix, and stands."""

    def running(self):
        self.send("odom", odometry(time.time(), 0.0, 0.0, (0.0, 0.0, 0.0)))
        return self.node.state() == "running"


@pytest.mark.parametrize("age", [3.0, 2000.0])
@pytest.mark.parametrize("others", [0, 1])
def test_the_filter_starts_from_it_however_old_it_is_and_again_after_a_reset(nodes, age, others):
    latched = nodes.peer.publisher(PoseWithCovarianceStamped, "global_pose", LATCHED)
    volatile = [nodes.peer.publisher(PoseWithCovarianceStamped, "global_pose") for _ in range(others)]
    latched.publish(fix(time.time() - age, 2.0, 1.0, 0.5))
    fed = LateFilter(nodes, EkfNode, {"sensor_timeout": 600.0})
    nodes.peer.spin_until(fed.running, what="the start")
    assert fed.node.localization.estimate().pose == pytest.approx((2.0, 1.0, 0.5), abs=1e-6)
    nodes.peer.spin_until(lambda: not fed.node._latched, what="the end of the second subscription")
    # What comes afterwards is received once.
    latched.publish(fix(time.time(), 2.01, 1.0, 0.5))
    nodes.peer.spin_until(lambda: fed.node.health.accepted["global_pose"], what="the next fix")
    assert not fed.node.health.dropped["global_pose", "duplicate"]
    assert nodes.peer.call(Trigger, "ekf/reset").success
    nodes.peer.spin_until(fed.running, what="the start after a reset")
    assert len(volatile) == others


def test_joint_states_of_an_arm_are_ignored_and_named_only_without_those_of_the_wheels(nodes):
    fed = one_process.Fed(nodes, EkfNode, {"odometry_source": "joint_states", "reliable_inputs": True})
    arm = JointState(name=["arm_1", "gripper"], position=[0.1, 0.2])
    fed.send("joint_states", arm)
    text = "joint_states has neither 'left_wheel_joint' nor 'right_wheel_joint', but arm_1, gripper"
    nodes.peer.spin_until(lambda: text in fed.node.health_level()[1], what="the warning")
    wheels = JointState(name=["left_wheel_joint", "right_wheel_joint"], velocity=[1.0, 1.0])
    wheels.header.stamp = fed.node.get_clock().now().to_msg()
    fed.send("joint_states", wheels)
    fed.send("joint_states", arm)
    nodes.peer.spin_until(lambda: text not in fed.node.health_level()[1], what="the end of the warning")
    assert [kind for _, kind in fed.node.health.dropped] == ["no fix yet"]
