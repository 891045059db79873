"""Other nodes in C++ with the project's nodes: robot_localization and Nav2's lifecycle manager."""

import graph
from lifecycle_msgs.srv import GetState
from nav2_msgs.srv import ManageLifecycleNodes
from nav_msgs.msg import Odometry
from overlay import errors_of_goals, program
from robot import DEEP, SIMULATED, robot

FAST = {"clock": "scaled", "real_time_factor": 4.0, "seed": 11}
GOALS = 20
TOLERANCE = 0.1
"""[m] and [rad], the controller's default"""


def recipe():
    """Return the parameter file that other-localization.md names, as it is installed."""
    from ament_index_python.packages import get_package_share_directory

    return f"{get_package_share_directory('diffbot')}/config/robot_localization.yaml"


def test_goals_are_reached_on_the_pose_of_robot_localization(figures):
    file = "--params-file", recipe()
    with (
        robot(FAST, controller=SIMULATED, only=("controller", "plant"), arguments={"controller": file}) as driving,
        program("robot_localization", "ekf_node", "--ros-args", *file, "-p", "use_sim_time:=true"),
    ):
        poses = driving.peer.subscribe(Odometry, "odometry/filtered", DEEP)
        driving.peer.spin_until(lambda: poses, what="a pose of robot_localization")
        errors = errors_of_goals(driving, GOALS, 3.0)
    # Reached means within the tolerance with a probability of 0.99, by an estimate that is not this project's.
    assert sum(error < TOLERANCE for error in errors) >= GOALS - 1
    figures["goals on robot_localization's pose"] = {"reached": len(errors), "of": GOALS, "worst error": max(errors)}


NODES = "ekf", "controller"
MANAGER = ("--ros-args", "-p", f"node_names:=[{', '.join(NODES)}]", "-p", "autostart:=true", "-p", "bond_timeout:=0.0")


def test_nav2s_lifecycle_manager_starts_pauses_resets_and_shuts_down_the_nodes():
    waiting = {"autostart": False}
    with robot(ekf=waiting, controller=waiting, only=("plant",)) as driving:
        for name in NODES:
            driving.launch(name, waiting)

        def state(name):
            return driving.peer.call(GetState, f"{name}/get_state").current_state.label

        def becomes(label):
            graph.wait_for(lambda: {state(name) for name in NODES} == {label}, what=label)

        becomes("unconfigured")
        with program("nav2_lifecycle_manager", "lifecycle_manager", *MANAGER):
            becomes("active")
            driving.send_goal(-1.0, -4.0, 0.0, tries=5)
            driving.wait_for_state("goal reached", 60.0)

            def manage(command):
                request = ManageLifecycleNodes.Request(command=getattr(ManageLifecycleNodes.Request, command))
                return driving.peer.call(ManageLifecycleNodes, "/lifecycle_manager/manage_nodes", request).success

            for command, label in (
                ("PAUSE", "inactive"),
                ("RESUME", "active"),
                ("RESET", "unconfigured"),
                ("STARTUP", "active"),
            ):
                assert manage(command)
                becomes(label)
            driving.send_goal(1.0, -2.0, 0.0, tries=5)
            driving.wait_for_state("goal reached", 60.0)
            assert manage("SHUTDOWN")
            becomes("finalized")
