"""Plant, EKF and controller, and a recorder if asked; for a full ROS 2 installation.

ros2 launch diffbot diffbot.launch.py [namespace:=robot1] [simulate:=false] [localization:=false]
    [clock:=wall|scaled|lockstep] [parameters:=FILE] [bag:=FOLDER]
"""

from pathlib import Path
from typing import Any

from ament_index_python.packages import get_package_share_directory
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from launch import LaunchContext, LaunchDescription


def generate_launch_description() -> LaunchDescription:
    """Declare the arguments; the nodes follow from their values."""
    share = Path(get_package_share_directory("diffbot"))
    arguments = {
        "namespace": ("", "namespace of the robot; a second one makes a second robot"),
        "simulate": ("true", "start the plant; false on a real robot"),
        "localization": ("true", "start the ekf; false if another localization publishes the pose"),
        "clock": ("wall", "wall, scaled or lockstep (only with simulate)"),
        "parameters": (str(share / "config" / "diffbot.yaml"), "parameter file of all nodes"),
        "bag": ("", "record everything into this folder"),
    }
    declared = [
        DeclareLaunchArgument(name, default_value=default, description=text)
        for name, (default, text) in arguments.items()
    ]
    return LaunchDescription([*declared, OpaqueFunction(function=_nodes)])


def _nodes(context: LaunchContext) -> list[Node]:
    value = {
        name: LaunchConfiguration(name).perform(context)
        for name in ("namespace", "simulate", "localization", "clock", "parameters", "bag")
    }
    simulate, localization = (value[name].lower() in ("true", "1", "yes") for name in ("simulate", "localization"))
    use_sim_time = simulate and value["clock"] != "wall"
    common = [value["parameters"], {"use_sim_time": use_sim_time}]

    def node(name: str, *parameters: dict[str, Any]) -> Node:
        return Node(
            package="diffbot",
            executable=f"{name}_node",
            name=name,
            namespace=value["namespace"],
            parameters=[*common, *parameters],
            output="screen",
        )

    lockstep = {"reliable_inputs": True} if value["clock"] == "lockstep" else {}
    nodes = [node("controller", lockstep | ({"publish_when_idle": True} if lockstep else {}))]
    if localization:
        nodes.insert(0, node("ekf", lockstep))
    if value["bag"]:
        nodes.insert(0, node("recorder", {"uri": value["bag"]}))
    if simulate:
        # The plant makes the time that the others use.
        nodes.append(node("plant", {"clock": value["clock"], "use_sim_time": False}))
    return nodes
