"""Goals on the poses of Nav2's AMCL, from simulated scans of a room, with the parameters of other-localization.md."""

import sys
from pathlib import Path

import graph
import laser_room
from ament_index_python.packages import get_package_share_directory
from geometry_msgs.msg import PoseWithCovarianceStamped
from overlay import errors_of_goals, program
from robot import DEEP, SIMULATED, initialpose, robot

START = 0.5, -0.3, 0.4
PLANT = {
    "clock": "scaled",
    "fix_rate": 0.0,
    "seed": 5,
    **dict(zip(("initial_pose.x", "initial_pose.y", "initial_pose.yaw"), START, strict=True)),
}
MANAGED = "-p", "node_names:=[amcl]", "-p", "autostart:=true"
GOALS = 20
TOLERANCE = 0.15
"""[m] and [rad], as the page recommends"""
CONTROLLER = {**SIMULATED, "xy_goal_tolerance": TOLERANCE, "yaw_goal_tolerance": TOLERANCE}


def test_goals_are_reached_on_the_fixes_of_amcl(figures):
    recipe = "--params-file", f"{get_package_share_directory('diffbot')}/config/amcl.yaml"
    simulated = "-p", "use_sim_time:=true"
    room = graph.environment(PYTHONSAFEPATH="")
    with (
        robot(PLANT, SIMULATED, CONTROLLER, arguments={"ekf": (*recipe, "-r", "global_pose:=amcl_pose")}) as driving,
        graph.process(sys.executable, str(Path(laser_room.__file__)), env=room),
        program("nav2_amcl", "amcl", "--ros-args", *recipe, *simulated),
        program("nav2_lifecycle_manager", "lifecycle_manager", "--ros-args", *simulated, *MANAGED),
    ):
        fixes = driving.peer.subscribe(PoseWithCovarianceStamped, "amcl_pose", DEEP)
        start = driving.peer.publisher(PoseWithCovarianceStamped, "initialpose")
        driving.peer.wait_for_subscribers(start, count=2)

        def located():
            start.publish(initialpose(*START))
            return driving.peer.comes_true(lambda: fixes, 2.0)

        graph.wait_for(located, what="a pose of AMCL")
        errors = errors_of_goals(driving, GOALS, 2.5)
    # Reached means within the tolerance with a probability of 0.99, by an estimate whose fixes are AMCL's.
    assert sum(error < TOLERANCE for error in errors) >= GOALS - 1
    figures["goals on AMCL's fixes"] = {"reached": len(errors), "of": GOALS, "worst error": max(errors)}
