"""A path over DDS: its waypoints in order, and the status that reports them."""

import math

import graph
import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from inside import inside
from nav_msgs.msg import Path
from rclpy.qos import DurabilityPolicy, QoSProfile
from robot import distance, planar, pose_stamped, stamp, turned

RADIUS = 0.4
START = 1000 * 10**9
ALL_STATES = QoSProfile(depth=1000, durability=DurabilityPolicy.TRANSIENT_LOCAL)
ROUTE = [(-1.0, -3.0, 1.0), (1.0, -2.0, 0.5), (1.0, -0.5, 2.5)]


def waypoints(states):
    """Numbers of the waypoint in statuses, repetitions left out."""
    texts = [values["waypoint"] for values in map(graph.values, states) if "waypoint" in values]
    return [text for index, text in enumerate(texts) if index == 0 or text != texts[index - 1]]


def test_waypoints_within_the_radius_are_passed_without_a_stop_and_the_last_one_is_reached():
    with inside({"seed": 12}, controller={"waypoint_radius": RADIUS}) as robot:
        paths = robot.peer.publisher(Path, "path", QoSProfile(depth=10))
        states = robot.peer.subscribe(DiagnosticStatus, "controller/status", ALL_STATES)
        robot.peer.wait_for_subscribers(paths)
        robot.peer.wait_for_publishers("controller/status")
        path = Path(poses=[pose_stamped(*goal) for goal in ROUTE])
        path.header.frame_id = "map"
        paths.publish(path)
        robot.peer.spin_until(lambda: waypoints(states) == ["1/3"], what="the path in the status")
        robot.run(lambda: states[-1].message == "goal reached", "the end of the path")
        assert waypoints(states) == ["1/3", "2/3", "3/3"]
        truths = {(stamp(message) - START) // 10**8: planar(message.pose.pose) for message in robot.truths}
        for goal in ROUTE[:2]:
            assert min(distance(pose, goal) for pose in truths.values()) < RADIUS
            # It did not stop at those it passed.
            near = [step for step, pose in truths.items() if distance(pose, goal) < RADIUS and step + 1 in truths]
            assert min(distance(truths[step], truths[step + 1]) for step in near) > 0.01
        final = robot.true_pose()
        assert distance(final, ROUTE[-1]) < 0.1
        assert turned(final, ROUTE[-1]) < 0.1
        # The robot stands still; a status that was sent since then is about the newest pose.
        states.clear()
        robot.peer.spin_until(lambda: states, what="a status")
        values = graph.values(states[-1])
        # Waypoints that were passed are not counted.
        assert (values["region"], values["waypoint"], values["goals reached"]) == ("Omega_L", "3/3", "1")
        # 99 % of a Rayleigh and of a normal distribution.
        P = np.array(robot.poses[-1].pose.covariance).reshape(6, 6)
        expected = 3.0349 * math.sqrt(np.linalg.eigvalsh(P[:2, :2])[-1]), 2.5758 * math.sqrt(P[5, 5])
        found = float(values["smallest tolerance [m]"]), float(values["smallest tolerance [rad]"])
        assert found == pytest.approx(expected, abs=6e-5)
