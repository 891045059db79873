"""Drives with a lossy odometry: plant, relay, filter and controller in one process."""

import math

import one_process
from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped
from lossy_relay import LossyRelay
from nav_msgs.msg import Odometry
from robot import planar, pose_stamped

from diffbot_control.controller_node import ControllerNode
from diffbot_control.ekf_node import EkfNode
from diffbot_sim.plant_node import PlantNode

LOSS = 0.2
RADIUS = 3.0
"""[m] of the circle on which the goals are."""


def goals(count):
    """Return goals around the start, each with another heading."""
    angles = [2.4 * number for number in range(count)]
    return [(RADIUS * math.cos(one), RADIUS * math.sin(one), math.remainder(1.7 * one, 2 * math.pi)) for one in angles]


def drive(count, timeout, seed=1, on_goal=None):
    """Drive to ``count`` goals one after the other; return true poses at the ends, goals reached, and the relays.

    A fifth of the odometry and of the fixes is lost on the way to the filter, and comes best effort. ``timeout`` [s] is
    that of each goal; a busy machine takes many times the simulated time.
    """
    ends = []
    with one_process.nodes() as nodes:
        peer = nodes.peer
        relays = [
            LossyRelay(peer.node, Odometry, "odom", "lossy/odom", LOSS, seed),
            LossyRelay(peer.node, PoseWithCovarianceStamped, "global_pose", "lossy/global_pose", LOSS, seed + 1),
        ]
        simulated = {"use_sim_time": True}
        nodes.add(EkfNode, simulated, ("-r", "odom:=lossy/odom", "-r", "global_pose:=lossy/global_pose"))
        controller = nodes.add(ControllerNode, simulated)
        nodes.add(PlantNode, {"clock": "scaled", "real_time_factor": 4.0, "seed": seed})
        truths = peer.subscribe(Odometry, "ground_truth")
        sender = peer.publisher(PoseStamped, "goal_pose")
        peer.wait_for_subscribers(sender)
        peer.spin_until(lambda: controller.health.accepted["pose"] > 10, 60.0, "poses")
        for number, goal in enumerate(goals(count), 1):
            sender.publish(pose_stamped(*goal))
            peer.spin_until(
                lambda number=number: controller.supervisor.goals_reached == number,
                timeout,
                f"goal {number} of {count}",
            )
            ends.append(planar(truths[-1].pose.pose))
            if on_goal is not None:
                on_goal(number)
        return ends, controller.supervisor.goals_reached, relays
