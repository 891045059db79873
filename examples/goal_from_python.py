"""Start a simulated robot, send it a goal from Python, wait for the end of the drive, and record a bag.

    python examples/goal_from_python.py [BAG]

BAG is the folder of the bag; the default is drive. Needs ROS 2 or its wheels (extra ``jazzy``). With your own robot,
you need only ``drive_to``. The simulation is four times as fast as real time and uses its own ROS domain.
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
    """Send a goal [m, m, rad] in map and wait for its end; return True if it was reached."""
    goal = PoseStamped()
    goal.header.frame_id = "map"
    goal.pose.position.x, goal.pose.position.y = x, y
    goal.pose.orientation.z, goal.pose.orientation.w = math.sin(0.5 * yaw), math.cos(0.5 * yaw)
    if navigator.waitUntilReady(timeout=60.0) and navigator.goToPose(goal):
        while not navigator.isTaskComplete():
            if navigator.getFeedback() is not None:
                print(f"{navigator.getFeedback().distance_remaining:.2f} m to go", flush=True)
    print(navigator.getReason() or "no controller accepted the goal")
    return navigator.getResult() == TaskResult.SUCCEEDED


if __name__ == "__main__":
    bag = Path(sys.argv[1] if len(sys.argv) > 1 else "drive").resolve()
    if bag.exists():
        sys.exit(f"{bag} already exists: choose another folder")
    domain = PrivateDomain()
    os.environ.update(graph_environment(domain.id))
    with tempfile.TemporaryDirectory() as logs, NodeProcesses(domain.id, Path(logs)) as robot:
        robot.start("recorder", "diffbot_bag.recorder_node", {"uri": str(bag), **SIMULATED})
        robot.start("plant", "diffbot_sim.plant_node", {"clock": "scaled", "real_time_factor": 4.0})
        robot.start("ekf", "diffbot_control.ekf_node", SIMULATED)
        robot.start("controller", "diffbot_control.controller_node", SIMULATED)
        rclpy.init()
        navigator = Navigator()
        # The subscribers are the controller and the recorder, which discovers the topics one by one.
        navigator.spin_until(lambda: navigator.count_subscribers("pose") >= 2, 60.0)
        reached = drive_to(navigator, 0.0, 0.0, 0.0)
        navigator.destroyNode()
        rclpy.shutdown()
    sys.exit(not reached)
