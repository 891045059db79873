"""The graph whose rights become config/sros2_policy.xml: the nodes of this project, run in a namespace.

In a namespace the graph tells relative names from absolute ones, such as /diagnostics.
"""

from __future__ import annotations

import os
import tempfile
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import rclpy
from geometry_msgs.msg import PoseStamped
from rclpy.node import Node, NodeNameNonExistentError
from rclpy.signals import SignalHandlerOptions

from diffbot_bag.bag.new_bag import new_bag
from diffbot_bag.bag.qos import Qos
from diffbot_bag.ros.replay_services import PLAYER_NAME, ROSBAG2_SERVICES
from diffbot_control.ros.goals.client import GoalClient
from diffbot_core.errors import DiffbotError
from diffbot_lab.security.policy import Rights
from diffbot_lab.security.ros.graph_rights import rights_of
from diffbot_tools.demo.command import RECORDED_TOPICS
from diffbot_tools.demo.processes import NodeProcesses, PrivateDomain, localhost_discovery

NAMESPACE = "/reference"
PROCESSES = {
    "plant": ("plant",),
    "ekf": ("ekf",),
    "controller": ("controller",),
    "robot": ("ekf", "controller"),
    "recorder": ("recorder",),
    "replay": ("replay",),
    "goal": ("goal_client",),
}
"""Nodes of each process that gets an enclave; robot_node is not run, since its nodes have the rights of the two."""
REPLAYED = {
    "global_pose": "geometry_msgs/msg/PoseWithCovarianceStamped",
    "ground_truth": "nav_msgs/msg/Odometry",
    "heading": "sensor_msgs/msg/Imu",
    "imu": "sensor_msgs/msg/Imu",
    "joint_states": "sensor_msgs/msg/JointState",
    "landmarks": "sensor_msgs/msg/PointCloud2",
    "odom": "nav_msgs/msg/Odometry",
}
"""Topics that a replay may publish: what a filter needs. No command and no pose: these would move a robot."""
NOT_IN_WHEELS: Mapping[str, Rights] = {
    "plant": Rights(publish=frozenset({"/tf"})),
    "ekf": Rights(publish=frozenset({"/tf"})),
    "controller": Rights(
        subscribe=frozenset({"/tf", "/tf_static"}),
        execute=frozenset({"navigate_to_pose", "navigate_through_poses"}),
    ),
    "replay": Rights(reply=frozenset(f"{PLAYER_NAME}/{name}" for name in ROSBAG2_SERVICES)),
}
"""Rights for what exists with tf2_msgs, tf2_ros, nav2_msgs and rosbag2_interfaces only: on a full ROS installation."""
TEMPORARY: Mapping[str, Rights] = {
    "recorder": Rights(
        request=frozenset(
            f"{node}/{service}"
            for node in ("controller", "ekf", "plant")
            for service in ("get_parameters", "list_parameters")
        )
    ),
}
"""Rights for what a node has in the graph for a moment only: the recorder asks the others for their parameters."""
_SIMULATED = {"use_sim_time": True}
_LANDMARK = {"landmark_ids": [1], "landmark_x": [1.0], "landmark_y": [1.0]}
_TIMEOUT, _QUIET, _POLL = 60.0, 2.0, 0.1
"""[s] for the graph to be complete, without a change after which it is, and between two looks at it"""

AllRights = dict[str, dict[str, Rights]]
"""By process and node."""


@contextmanager
def running_graph(domain: int) -> Iterator[Node]:
    """Run the nodes on a ROS_DOMAIN_ID of this machine; yield a node that observes them."""
    with tempfile.TemporaryDirectory() as folder, NodeProcesses(domain, Path(folder), NAMESPACE) as processes:
        for name, (module, parameters) in _nodes(Path(folder)).items():
            processes.start(name, module, parameters)
        context = rclpy.Context()
        rclpy.init(context=context, domain_id=domain, signal_handler_options=SignalHandlerOptions.NO)
        try:
            observer = Node("observer", namespace=NAMESPACE, context=context)
            observer.create_publisher(PoseStamped, "goal_pose", 1)  # or the recorder would not subscribe to it
            client = GoalClient(namespace=NAMESPACE, context=context)
            yield observer
            client.close(shut_down=False)
            observer.destroy_node()
        finally:
            rclpy.try_shutdown(context=context)


def _nodes(folder: Path) -> dict[str, tuple[str, dict[str, Any]]]:
    """Return module and parameters of each node that is run; bags are in ``folder``."""
    bag = folder / "bag"
    with new_bag(bag) as writer:
        channels = [writer.add_topic(f"{NAMESPACE}/{name}", kind, [Qos()]) for name, kind in REPLAYED.items()]
        writer.write(channels[0], b"", 0, 0)  # never sent
    recorder = {
        "uri": str(folder / "recorded"),
        "topics": list(RECORDED_TOPICS),
        "record_parameters": False,
        **_SIMULATED,
    }
    replay = {"uri": str(bag), "clock": 100.0, "start_paused": True, "wait_timeout": 0.0}
    return {
        "plant": ("diffbot_sim.plant_node", {"clock": "scaled", "start_paused": True, **_LANDMARK}),
        "ekf": ("diffbot_control.ekf_node", {**_SIMULATED, **_LANDMARK, "use_gyro": True}),
        "controller": ("diffbot_control.controller_node", _SIMULATED),
        "recorder": ("diffbot_bag.recorder_node", recorder),
        "replay": ("diffbot_bag.replay_node", replay),
    }


def present_rights(observer: Node) -> AllRights:
    """Return the rights that the nodes have at present; nothing before all of them are discovered."""
    names = {name for members in PROCESSES.values() for name in members}
    try:
        found = {name: rights_of(observer, name, NAMESPACE) for name in names}
    except NodeNameNonExistentError:
        return {}
    if not frozenset(RECORDED_TOPICS) <= found["recorder"].subscribe:
        return {}
    rights = {
        name: one | NOT_IN_WHEELS.get(name, Rights()) | TEMPORARY.get(name, Rights()) for name, one in found.items()
    }
    return {process: {name: rights[name] for name in members} for process, members in PROCESSES.items()}


def reference_rights() -> AllRights:
    """Run the nodes on a domain of their own and return their rights, once these do not change any more.

    Raises:
        DiffbotError: if that takes too long.
    """
    domain = PrivateDomain()
    os.environ |= localhost_discovery()
    try:
        with running_graph(domain.id) as observer:
            begin = changed = time.monotonic()
            found: AllRights = {}
            while not found or time.monotonic() - changed < _QUIET:
                if time.monotonic() - begin > _TIMEOUT:
                    raise DiffbotError(f"the graph is not complete after {_TIMEOUT:g} s")
                if (now := present_rights(observer)) != found:
                    found, changed = now, time.monotonic()
                time.sleep(_POLL)
            return found
    finally:
        domain.release()
