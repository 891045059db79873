"""The controller fed by odometry/filtered instead of pose, as robot_localization sends it."""

import graph
import one_process
import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from filter_input import timed
from geometry_msgs.msg import Twist
from nav_msgs.msg import Odometry
from rclpy.parameter import Parameter
from robot import LATCHED, pose_stamped, twist

from diffbot_control.controller_node import ControllerNode
from diffbot_control.law.presets import PRESETS

SIGMAS = PRESETS["tuned"].tolerance.goal_sigmas
GOAL = (1.0, 2.0, 0.5)


class Standing(one_process.Fed):
    """A controller whose robot stands at the goal."""

    def __init__(self, nodes):
        super().__init__(nodes, ControllerNode, {"pose_source": "odometry", "pose_timeout": 60.0})
        self.commands = self.peer.subscribe(Twist, "cmd_vel")
        self.states = self.peer.subscribe(DiagnosticStatus, "controller/status", LATCHED)
        self.send("goal_pose", pose_stamped(*GOAL))
        self.time = 1000.0

    def feed(self, variance, expected):
        """Send odometry of this variance until the controller's state is the expected one; return its status."""

        def reported():
            self.time += 0.1
            message = timed(Odometry(child_frame_id="base_link"), self.time)
            message.header.frame_id = "map"
            message.pose.pose = pose_stamped(*GOAL).pose
            message.pose.covariance[[0, 7, 35]] = variance
            self.send("odometry/filtered", message)
            return self.states and self.states[-1].message == expected

        self.states.clear()
        self.peer.spin_until(reported, what=f"the state {expected!r}")
        return self.states[-1]


@pytest.fixture
def standing():
    with one_process.nodes() as nodes:
        yield Standing(nodes)


def smallest_tolerance(status):
    values = graph.values(status)
    return [float(values[f"smallest tolerance [{unit}]"]) for unit in ("m", "rad")]


def test_covariance_of_the_odometry_decides_whether_the_goal_is_reached(standing):
    status = standing.feed(4.0, "tolerance below uncertainty")
    assert status.level == DiagnosticStatus.WARN
    assert twist(standing.commands[-1]) == pytest.approx((0.0, 0.0), abs=1e-9)
    assert smallest_tolerance(status) == pytest.approx([2.0 * SIGMAS] * 2)
    status = standing.feed(1e-4, "goal reached")
    assert status.level == DiagnosticStatus.OK
    assert smallest_tolerance(status) == pytest.approx([0.01 * SIGMAS] * 2)


def test_a_pose_without_covariance_has_the_uncertainty_of_the_parameters(standing, capfd):
    status = standing.feed(0.0, "goal reached")
    assert smallest_tolerance(status) == pytest.approx([0.02 * SIGMAS] * 2)
    text = "odometry/filtered: covariance is all zero, i.e. unknown: assuming pose_sigma_xy = 0.02 m"
    assert capfd.readouterr().err.count(text) == 1
    health = standing.node.health
    assert health.counted["odometry/filtered with the covariance of the parameters"] == standing.handled(
        "odometry/filtered"
    )
    standing.node.set_parameters([Parameter("pose_sigma_xy", value=0.03)])
    assert smallest_tolerance(standing.feed(0.0, "goal reached"))[0] == pytest.approx(0.03 * SIGMAS)
