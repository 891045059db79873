"""Parameter files: what ``ros2 param dump`` writes starts the node again, and ``ros2 param load`` takes it."""

import math

import one_process
import pytest
import yaml
from diagnostic_msgs.msg import DiagnosticStatus
from nav_msgs.msg import Odometry
from rcl_interfaces.srv import DescribeParameters, GetParameters, ListParameters, SetParameters
from rclpy.parameter import PARAMETER_SEPARATOR_STRING, parameter_dict_from_yaml_file, parameter_value_to_python
from robot import LATCHED
from std_srvs.srv import Trigger

from diffbot_bag.parameters import RecorderConfig, ReplayConfig
from diffbot_control.controller_node import ControllerNode
from diffbot_control.ekf_node import EkfNode
from diffbot_control.ros.controller_parameters import ControllerNodeConfig
from diffbot_control.ros.ekf_parameters import EkfNodeConfig
from diffbot_core.errors import InvalidValueError
from diffbot_core.ros.node import DiffbotNode
from diffbot_core.ros.parameter_names import PARAMETER_NAMES
from diffbot_core.schema import parameters_of
from diffbot_sim.plant_node import PlantNode
from diffbot_sim.ros.parameters import PlantNodeConfig


class Recorder(DiffbotNode):
    """The recorder's parameters without a bag."""

    qos_by_parameters = False

    def __init__(self, **options):
        super().__init__("recorder", RecorderConfig, **options)


class Replay(DiffbotNode):
    """The replay's parameters without a bag."""

    qos_by_parameters = False

    def __init__(self, **options):
        super().__init__("replay", ReplayConfig, **options)


NODES = {
    "controller": (ControllerNode, {"linear.x.max_velocity": math.inf, "gamma": 2}),
    "ekf": (EkfNode, {"landmark_ids": [4, 2], "landmark_x": [1.0, 2.5], "landmark_y": [0.0, -1.5]}),
    "plant": (PlantNode, {"start_paused": True, "seed": 5}),
    "recorder": (Recorder, {"topics": ["odom", "1.0", "true"]}),
    "replay": (Replay, {"remap": ["a:=b"]}),
}


@pytest.fixture(scope="module")
def running():
    with one_process.nodes() as nodes:
        yield nodes


def dumped(running, node):
    """Return what ``ros2 param dump`` prints: the steps of ros2param's verb, by the same services."""
    name = node.get_fully_qualified_name()
    names = sorted(running.peer.call(ListParameters, f"{name}/list_parameters").result.names)
    request = GetParameters.Request(names=names)
    found = running.peer.call(GetParameters, f"{name}/get_parameters", request).values
    tree = {}
    for key, value in zip(names, found, strict=True):
        *groups, last = key.split(PARAMETER_SEPARATOR_STRING)
        place = tree
        for group in groups:
            place = place.setdefault(group, {})
        place[last] = parameter_value_to_python(value)
        if hasattr(place[last], "tolist"):
            place[last] = place[last].tolist()
    return yaml.dump({name: {"ros__parameters": tree}}, default_flow_style=False)


@pytest.mark.parametrize("name", NODES)
def test_a_dump_starts_the_node_and_its_dump_again_with_the_same_values(running, name, tmp_path):
    kind, parameters = NODES[name]
    node = running.add(kind, parameters)
    first = dumped(running, node)
    running.remove(node)
    assert "null" not in first
    texts = [first]
    for count in range(2):
        file = tmp_path / f"{count}.yaml"
        file.write_text(texts[-1])
        node = running.add(kind, arguments=("--params-file", str(file)))
        texts.append(dumped(running, node))
        if count == 0:
            running.remove(node)
    assert texts[1] == texts[0]
    assert texts[2] == texts[0]
    # And it is loaded into the running node: what can be changed is set, the rest is read-only.
    loaded = parameter_dict_from_yaml_file(str(file))
    request = SetParameters.Request(parameters=list(loaded.values()))
    results = running.peer.call(SetParameters, f"{name}/set_parameters", request).results
    refused = [result.reason for result in results if not result.successful]
    assert all("read-only" in reason for reason in refused), refused
    assert sum(result.successful for result in results) >= sum(
        not parameter.spec.read_only for parameter in parameters_of(type(node.config))
    )
    assert dumped(running, node) == texts[0]
    running.remove(node)


def test_a_file_for_all_nodes_warns_of_unknown_names_only(running, tmp_path, capfd):
    file = tmp_path / "all.yaml"
    known = (
        "landmark_rate: 0.0\n    fix_rate: 5.0\n    gamma: 1.0\n    hold_goal: true\n    state_file: ''\n    uri: bag"
    )
    qos = "qos_overrides:\n      /odom:\n        subscription:\n          depth: 7"
    file.write_text(f"/**:\n  ros__parameters:\n    {known}\n    {qos}\n    gama: 2.0\n")
    node = running.add(EkfNode, arguments=("--params-file", str(file)))
    output = "".join(capfd.readouterr())
    assert "unknown parameter 'gama' is ignored; did you mean 'gamma'?" in output
    assert output.count("unknown parameter") == 1
    assert node.get_parameter("qos_overrides./odom.subscription.depth").value == 7
    running.remove(node)


def test_the_known_names_are_those_of_all_nodes():
    configs = (ControllerNodeConfig, EkfNodeConfig, PlantNodeConfig, RecorderConfig, ReplayConfig)
    assert {parameter.name for config in configs for parameter in parameters_of(config)} <= PARAMETER_NAMES
    assert "gama" not in PARAMETER_NAMES


def test_ranges_are_described_unless_a_number_may_be_infinite(running):
    node = running.add(PlantNode, {"start_paused": True})
    names = ["fix_rate", "seed", "wheel_radius", "wheel_speed_max", "fix_dropout"]
    request = DescribeParameters.Request(names=names)
    found = running.peer.call(DescribeParameters, "plant/describe_parameters", request).descriptors
    fix_rate, seed, wheel_radius, wheel_speed_max, fix_dropout = found
    assert [(one.from_value, one.to_value) for one in fix_rate.floating_point_range] == [(0.0, 1000.0)]
    assert [(one.from_value, one.to_value, one.step) for one in seed.integer_range] == [(0, 2**63 - 1, 1)]
    assert [(one.from_value, one.to_value) for one in fix_dropout.floating_point_range] == [(0.0, 1.0)]
    assert [(one.from_value, one.to_value) for one in wheel_radius.floating_point_range] == [(1e-3, 10.0)]
    assert not wheel_speed_max.floating_point_range  # inf: no limit
    running.remove(node)


@pytest.mark.parametrize("text", ["inf", ".inf"])
def test_infinity_as_text_is_a_number(running, text):
    node = running.add(ControllerNode, {"linear.x.max_velocity": text})
    assert node.get_parameter("linear.x.max_velocity").value == math.inf
    running.remove(node)


def test_infinity_as_text_is_refused_where_infinity_is():
    with one_process.nodes() as nodes, pytest.raises(InvalidValueError, match=r"gamma = inf: must be"):
        nodes.add(ControllerNode, {"gamma": "inf"})


@pytest.mark.parametrize(
    ("name", "value", "text"),
    [
        ("reliability", "perfect", "= 'perfect': must be one of reliable, best_effort"),
        ("depth", 0, "= 0: must be >= 1 and <= 1e+06"),
        ("history", 3, "= 3: must be a text"),
    ],
)
def test_qos_overrides_that_are_not_allowed_are_named(name, value, text):
    parameter = f"qos_overrides./odom.subscription.{name}"
    with one_process.nodes() as nodes, pytest.raises(InvalidValueError) as caught:
        nodes.add(EkfNode, {parameter: value})
    assert str(caught.value).startswith(f"{parameter} {text}")


def test_qos_of_inputs_and_outputs_is_what_the_parameters_say(running):
    overrides = {
        "qos_overrides./r7/odom.subscription.reliability": "reliable",
        "qos_overrides./r7/pose.publisher.reliability": "best_effort",
        "qos_overrides./r7/pose.publisher.depth": 3,
    }
    node = running.add(EkfNode, overrides, ("-r", "__ns:=/r7"))
    (odom,) = running.peer.node.get_subscriptions_info_by_topic("/r7/odom")
    (heading,) = running.peer.node.get_subscriptions_info_by_topic("/r7/heading")
    (pose,) = running.peer.node.get_publishers_info_by_topic("/r7/pose")
    assert odom.qos_profile.reliability.name == "RELIABLE"
    assert heading.qos_profile.reliability.name == "BEST_EFFORT"
    assert pose.qos_profile.reliability.name == "BEST_EFFORT"
    assert node.get_parameter("qos_overrides./r7/pose.publisher.depth").value == 3
    running.remove(node)


def test_a_rate_without_anything_to_measure_is_reported(running, capfd):
    node = running.add(PlantNode, {"start_paused": True, "landmark_rate": 5.0})
    assert "landmark_rate = 5 Hz, but landmark_ids is empty: no landmarks are sent" in "".join(capfd.readouterr())
    running.remove(node)
    landmarks = {"landmark_ids": [1], "landmark_x": [0.0], "landmark_y": [0.0]}
    node = running.add(PlantNode, {"start_paused": True, "landmark_rate": 5.0, **landmarks})
    assert "landmark_ids is empty" not in "".join(capfd.readouterr())
    running.remove(node)


@pytest.mark.parametrize(("name", "kind"), [("ekf", EkfNode), ("controller", ControllerNode)])
def test_a_status_has_the_full_name_of_its_node(running, name, kind):
    node = running.add(kind, arguments=("-r", "__ns:=/deep/down"))
    received = running.peer.subscribe(DiagnosticStatus, f"/deep/down/{name}/status", LATCHED)
    running.peer.spin_until(lambda: received, 5.0, "a status")
    assert received[0].name == f"/deep/down/{name}"
    running.remove(node)


def test_a_reset_sets_the_counters_to_zero(running):
    node = running.add(EkfNode)
    odometries = running.peer.publisher(Odometry, "odom")
    running.peer.wait_for_subscribers(odometries)
    odometries.publish(Odometry(child_frame_id="somewhere"))
    running.peer.spin_until(lambda: node.health.dropped, 5.0, "a drop")
    assert "odom dropped: wrong child_frame_id" in node.health.report(1.0)
    assert running.peer.call(Trigger, "ekf/reset").success
    assert node.health.report(1.0) == {}
    running.remove(node)
