"""config/sros2_policy.xml allows each node the topics, services and actions that it uses, and no others."""

import xml.etree.ElementTree as ET
from pathlib import Path

import graph
import one_process
import pytest
from geometry_msgs.msg import PoseStamped

from diffbot_bag.qos import Qos
from diffbot_bag.recorder_node import RecorderNode
from diffbot_bag.replay_node import PLAYER_NAME, ReplayNode
from diffbot_bag.writer import new_bag
from diffbot_control.controller_node import ControllerNode
from diffbot_control.ekf_node import EkfNode
from diffbot_control.ros.goals.client import GoalClient
from diffbot_sim import plant_node
from diffbot_sim.plant_node import PlantNode
from diffbot_tools.demo import RECORDED_TOPICS

POLICY = Path(__file__).resolve().parents[2] / "config" / "sros2_policy.xml"
NAMESPACE = "/reference"
"""In a namespace, relative names differ from absolute names."""
PROCESSES = {
    **{name: (name,) for name in ("controller", "ekf", "plant", "recorder", "replay")},
    "goal": ("goal_client",),
    "robot": ("ekf", "controller"),
}
OF_ACTION = {"reply": "execute", "request": "call"}
"""Right of an action by the right of one of its services."""
REPLAYED = {
    "global_pose": "geometry_msgs/msg/PoseWithCovarianceStamped",
    "ground_truth": "nav_msgs/msg/Odometry",
    "heading": "sensor_msgs/msg/Imu",
    "imu": "sensor_msgs/msg/Imu",
    "joint_states": "sensor_msgs/msg/JointState",
    "landmarks": "sensor_msgs/msg/PointCloud2",
    "odom": "nav_msgs/msg/Odometry",
}
"""Inputs of the filter. A replay may publish neither commands nor poses, which would move a robot."""
ROSBAG2_SERVICES = (
    "get_rate", "is_paused", "pause", "play_next", "resume", "seek", "set_rate", "stop", "toggle_paused"
)  # fmt: skip
UNSEEN = {
    # These need tf2_msgs, nav2_msgs and rosbag2_interfaces, which only a full ROS installation has.
    *((name, "publish", "/tf") for name in ("plant", "ekf")),
    *(("controller", "subscribe", name) for name in ("/tf", "/tf_static")),
    *(("controller", "execute", name) for name in ("navigate_to_pose", "navigate_through_poses", "follow_path")),
    # The controller subscribes when a goal has no pose, to name the cause.
    ("controller", "subscribe", "ekf/status"),
    *(("replay", "reply", f"{PLAYER_NAME}/{name}") for name in ROSBAG2_SERVICES),
    # The recorder has these clients only for a moment, while it asks the other nodes for their parameters.
    *(("recorder", "request", f"{node}/{name}_parameters") for node in ("controller", "ekf", "plant")
      for name in ("get", "list")),
}  # fmt: skip


def allowed_by(policy):
    """Return (enclave, node, right, name) of every line."""
    return {
        (enclave.get("path").removeprefix("/diffbot/"), profile.get("node"), right, one.text)
        for enclave in policy.iter("enclave")
        for profile in enclave.iter("profile")
        for group in profile
        for right in group.attrib
        for one in group
    }


def needed_by_nodes(observer):
    """Return (enclave, node, right, name) of all that the nodes use and of UNSEEN, with actions as one name."""
    looks = {
        "publish": observer.get_publisher_names_and_types_by_node,
        "subscribe": observer.get_subscriber_names_and_types_by_node,
        "reply": observer.get_service_names_and_types_by_node,
        "request": observer.get_client_names_and_types_by_node,
    }
    found = set()
    for enclave, node in ((enclave, node) for enclave, nodes in PROCESSES.items() for node in nodes):
        found |= {(enclave, *one) for one in UNSEEN if one[0] == node}
        for right, name in ((right, name) for right, look in looks.items() for name, _ in look(node, NAMESPACE)):
            short = name.replace(f"{NAMESPACE}/{node}/", "~/").removeprefix(f"{NAMESPACE}/")
            if "/_action/" not in short:
                found.add((enclave, node, right, short))
            elif right in OF_ACTION:
                found.add((enclave, node, OF_ACTION[right], short.partition("/_action/")[0]))
    return found


@pytest.fixture
def observer(tmp_path):
    """Run all nodes in a namespace, and yield a node that discovers them."""
    with new_bag(tmp_path / "bag") as writer:
        channels = [writer.add_topic(f"{NAMESPACE}/{name}", kind, [Qos()]) for name, kind in REPLAYED.items()]
        writer.write(channels[0], b"", 0, 0)  # never sent
    simulated = {"use_sim_time": True}
    landmark = {"landmark_ids": [1], "landmark_x": [1.0], "landmark_y": [1.0]}
    recorded = {"uri": str(tmp_path / "recorded"), "topics": list(RECORDED_TOPICS), "record_parameters": False}
    replay = {"uri": str(tmp_path / "bag"), "clock": 100.0, "wait_timeout": 0.0, "disable_keyboard_controls": True}
    with one_process.nodes(namespace=NAMESPACE) as nodes:
        nodes.peer.publisher(PoseStamped, "goal_pose")  # or the recorder would not subscribe to it
        started = []
        for kind, parameters in (
            (PlantNode, {"clock": "scaled", "start_paused": True, **landmark}),
            (EkfNode, {**simulated, **landmark, "use_gyro": True}),
            (ControllerNode, simulated),
            (RecorderNode, {**recorded, **simulated}),
            (ReplayNode, {**replay, "start_paused": True}),
        ):
            started.append(nodes.add(kind, parameters, ("-r", f"__ns:={NAMESPACE}")))
        client = GoalClient(namespace=NAMESPACE, context=nodes.peer.context)
        yield nodes.peer
        client.close(shut_down=False)
        for node in started:
            node.before_shutdown()


def test_the_policy_allows_exactly_what_the_running_nodes_use(observer):
    policy = ET.parse(POLICY)
    observer.comes_true(lambda: needed_by_nodes(observer.node) == allowed_by(policy), graph.PATIENCE)
    needed = needed_by_nodes(observer.node)
    assert sorted(allowed_by(policy) ^ needed) == []


@pytest.mark.usefixtures("kept_signal_handlers")
def test_a_node_with_unusable_keys_does_not_start_and_reports_why_in_one_line(tmp_path, capfd, monkeypatch):
    """The keys are empty files. The middleware of the wheels is built without DDS Security and refuses all keys."""
    (tmp_path / "enclaves").mkdir()
    certificates = "identity_ca.cert.pem", "permissions_ca.cert.pem", "cert.pem"
    for name in (*certificates, "key.pem", "governance.p7s", "permissions.p7s"):
        (tmp_path / "enclaves" / name).touch()
    monkeypatch.setenv("ROS_SECURITY_KEYSTORE", str(tmp_path))
    monkeypatch.setenv("ROS_SECURITY_ENABLE", "true")
    monkeypatch.setenv("ROS_SECURITY_STRATEGY", "Enforce")
    monkeypatch.setenv("FASTDDS_BUILTIN_TRANSPORTS", "UDPv4")  # the node sets it
    assert plant_node.main([]) == 1
    output = "".join(capfd.readouterr())
    (line,) = [line for line in output.splitlines() if line.startswith("error: ")]
    assert "cannot create the node plant: " in line
    assert "Traceback" not in output
