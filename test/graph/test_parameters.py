"""Parameters of the nodes: refusals at the start and at run time, changes, dumps and files."""

import math

import pytest
import yaml
from geometry_msgs.msg import PoseWithCovarianceStamped
from rcl_interfaces.srv import GetParameters, ListParameters, SetParameters, SetParametersAtomically
from rclpy.parameter import PARAMETER_SEPARATOR_STRING, Parameter, parameter_dict_from_yaml_file
from rclpy.parameter import parameter_value_to_python as python_value

from diffbot_control.controller_node import ControllerNode
from diffbot_control.ekf_node import EkfNode
from diffbot_core.errors import DiffbotError
from diffbot_core.schema import parameters_of
from diffbot_sim import plant_node
from diffbot_sim.plant_node import PlantNode

NODES = {
    "controller": (ControllerNode, {"preset": "paper", "linear.x.max_velocity": math.inf, "gamma": 2}),
    "ekf": (EkfNode, {"landmark_ids": [4, 2], "landmark_x": [1.0, 2.5], "landmark_y": [0.0, -1.5]}),
    "plant": (PlantNode, {"start_paused": True, "seed": 5}),
}
"""Class of each node, and parameters with which it starts."""


def test_a_start_with_a_bad_value_is_refused_with_its_bound(nodes):
    with pytest.raises(DiffbotError, match=r"^qos_overrides./odom.subscription.depth = 0: must be >= 1"):
        nodes.add(EkfNode, {"qos_overrides./odom.subscription.depth": 0})


def test_changes_that_contradict_each_other_are_refused_and_several_parameters_can_change_at_once(nodes):
    nodes.add(ControllerNode, {"preset": "paper"})
    names = {SetParameters: "set_parameters", SetParametersAtomically: "set_parameters_atomically"}

    def change(service=SetParametersAtomically, **values):
        typed = [Parameter(name, value=value).to_parameter_msg() for name, value in values.items()]
        answer = nodes.peer.call(service, f"controller/{names[service]}", service.Request(parameters=typed))
        return answer.result if service is SetParametersAtomically else answer.results[0]

    def present(name):
        request = GetParameters.Request(names=[name])
        return python_value(nodes.peer.call(GetParameters, "controller/get_parameters", request).values[0])

    refused = change(SetParameters, eps_P_leave=0.3)
    assert (refused.successful, refused.reason) == (False, "eps_P_leave = 0.3: must be >= eps_P = 0.5")
    assert change(eps_P=0.2, eps_P_leave=0.3).successful
    assert not change(eps_P=0.25, eps_P_leave=0.1).successful
    assert present("eps_P") == 0.2
    # A float may be given as a whole number or as the text inf.
    assert change(SetParameters, gamma=2).successful
    assert change(SetParameters, **{"linear.x.max_velocity": "inf"}).successful
    assert (present("gamma"), present("linear.x.max_velocity")) == (2.0, math.inf)
    assert "read-only" in change(SetParameters, law="switching").reason


def dumped(peer, node):
    """Return the output of ``ros2 param dump``, which asks the same services."""
    name = node.get_fully_qualified_name()
    names = sorted(peer.call(ListParameters, f"{name}/list_parameters").result.names)
    found = peer.call(GetParameters, f"{name}/get_parameters", GetParameters.Request(names=names)).values
    tree = {}
    for key, value in zip(names, found, strict=True):
        *groups, last = key.split(PARAMETER_SEPARATOR_STRING)
        place = tree
        for group in groups:
            place = place.setdefault(group, {})
        place[last] = python_value(value)
        if hasattr(place[last], "tolist"):
            place[last] = place[last].tolist()
    return yaml.dump({name: {"ros__parameters": tree}}, default_flow_style=False)


@pytest.mark.parametrize("name", NODES)
def test_a_dump_can_start_the_node_again_and_can_be_loaded(nodes, name, tmp_path):
    kind, parameters = NODES[name]
    node = nodes.add(kind, parameters)
    first, file = dumped(nodes.peer, node), tmp_path / "dump.yaml"
    nodes.remove(node)
    assert "null" not in first
    file.write_text(first)
    node = nodes.add(kind, arguments=("--params-file", str(file)))
    assert dumped(nodes.peer, node) == first
    # All parameters are set but the read-only ones.
    request = SetParameters.Request(parameters=list(parameter_dict_from_yaml_file(str(file)).values()))
    results = nodes.peer.call(SetParameters, f"{name}/set_parameters", request).results
    assert all("read-only" in result.reason for result in results if not result.successful)
    changeable = [one for one in parameters_of(type(node.config)) if not one.spec.read_only]
    assert sum(result.successful for result in results) >= len(changeable)
    assert dumped(nodes.peer, node) == first


def test_the_detector_of_the_plant_can_be_switched_on_while_the_plant_runs(nodes):
    plant, detections = nodes.add(PlantNode), nodes.peer.subscribe(PoseWithCovarianceStamped, "detected_dock_pose")
    nodes.peer.spin_until(lambda: plant.step > 0, what="a step")
    plant.set_parameters([Parameter("detection_rate", value=10.0)])
    nodes.peer.spin_until(lambda: detections or plant.faults.newest, what="a detection")
    assert plant.faults.newest == ""


def test_an_argument_that_ros_would_ignore_in_a_namespace_ends_the_start(kept_signal_handlers, capfd, monkeypatch):
    monkeypatch.setenv("FASTDDS_BUILTIN_TRANSPORTS", "UDPv4")  # the node sets it
    assert plant_node.main(["--ros-args", "-r", "__ns:=/r1", "-p", "plant:initial_pose.y:=2.0"]) == 1
    (line,) = [one for one in capfd.readouterr().err.splitlines() if one.startswith("error: ")]
    assert "plant:initial_pose.y:=2.0" in line
    assert line.endswith("use a parameter file with /**/plant, or -p initial_pose.y:=2.0")
