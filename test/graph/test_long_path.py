"""A path of 10,000 poses keeps no command waiting; a longer one is refused."""

import math
import time
from itertools import pairwise

from geometry_msgs.msg import Twist
from nav_msgs.msg import Path
from rclpy.qos import QoSProfile
from rclpy.serialization import serialize_message
from robot import pose_stamped, robot

PERIOD = 0.1
"""[s] of the odometry, and so of the commands."""
ATTEMPTS = 6
"""Other processes of a busy machine can hold up any one command, but not each time."""


def test_no_command_waits_for_a_long_path_and_a_longer_one_is_refused():
    message = Path()
    message.header.frame_id = "map"
    message.poses = [pose_stamped(30.0 + 0.001 * index, 0.0, 0.0) for index in range(10_000)]
    long = serialize_message(message)
    message.poses.append(message.poses[-1])
    too_long = serialize_message(message)
    with robot() as running:
        peer, times, gaps = running.peer, [], []
        peer.node.create_subscription(Twist, "cmd_vel", lambda _: times.append(time.monotonic()), 10)
        paths = peer.publisher(Path, "path", QoSProfile(depth=10))
        peer.wait_for_subscribers(paths)
        running.send_goal(30.0, 0.0, 0.0)
        peer.spin_until(lambda: len(times) > 5, 15.0, "commands")
        while len(gaps) < ATTEMPTS and min(gaps, default=1.0) > 2.0 * PERIOD:
            peer.spin_for(0.3)
            times.clear()
            peer.spin_for(0.3)
            paths.publish(long)
            peer.spin_for(1.2)
            times.append(time.monotonic())
            gaps.append(max(after - before for before, after in pairwise(times)) if len(times) > 1 else math.inf)
        assert min(gaps) <= 2.0 * PERIOD, gaps
        assert "path dropped: path too long" not in running.diagnosis("controller")
        paths.publish(too_long)
        peer.spin_until(
            lambda: running.diagnosis("controller").get("path dropped: path too long") == "1", 10.0, "the refusal"
        )
