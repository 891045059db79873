"""Drive to a goal from Python: starts a simulated robot, sends it a goal, waits for the end, and records a bag.

    python examples/goal_from_python.py [BAG]        # the folder of the bag, default: drive

Needs ROS 2 or its wheels (extra ``jazzy``). On a running robot only ``drive_to`` is needed. The
simulation runs four times as fast as real time, on a ROS domain of its own.
"""

import math
import os
import sys
import tempfile
from pathlib import Path

import rclpy
from geometry_msgs.msg import PoseStamped

from diffbot_control.ros.navigator import Navigator, TaskResult
from diffbot_tools.processes import NodeProcesses, PrivateDomain, graph_environment

SIMULATED = {"use_sim_time": True}


def drive_to(navigator, x, y, yaw):
    """Send the goal [m, m, rad] in map and wait for its end; True if it was reached."""
    goal = PoseStamped()
    goal.header.frame_id = "map"
    goal.pose.position.x, goal.pose.position.y = x, y
    goal.pose.orientation.z, goal.pose.orientation.w = math.sin(0.5 * yaw), math.cos(0.5 * yaw)
    if navigator.waitUntilReady(timeout=60.0) and navigator.goToPose(goal):
        while not navigator.isTaskComplete():
            if navigator.getFeedback() is not None:
                print(f"{navigator.getFeedback().distance_remaining:.2f} m to go", flush=True)
    print(navigator.getReason() or "no controller took the goal")
    return navigator.getResult() == TaskResult.SUCCEEDED


if __name__ == "__main__":
    bag = Path(sys.argv[1] if len(sys.argv) > 1 else "drive").resolve()
    if bag.exists():
        sys.exit(f"{bag} exists: name another folder")
    domain = PrivateDomain()
    os.environ.update(graph_environment(domain.id))
    with tempfile.TemporaryDirectory() as logs, NodeProcesses(domain.id, Path(logs)) as robot:
        robot.start("recorder", "diffbot_bag.recorder_node", {"uri": str(bag), **SIMULATED})
        robot.start("plant", "diffbot_sim.plant_node", {"clock": "scaled", "real_time_factor": 4.0})
        robot.start("ekf", "diffbot_control.ekf_node", SIMULATED)
        robot.start("controller", "diffbot_control.controller_node", SIMULATED)
        rclpy.init()
        navigator = Navigator()
        # Two subscribers: the controller, and the recorder, which finds the topics one after the other.
        navigator.spin_until(lambda: navigator.count_subscribers("pose") >= 2, 60.0)
        reached = drive_to(navigator, 0.0, 0.0, 0.0)
        navigator.destroyNode()
        rclpy.shutdown()
    sys.exit(not reached)
