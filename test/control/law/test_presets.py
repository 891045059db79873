"""The ready-made controllers, and the node's parameter that chooses between them."""

import graph
import pytest
from driven import ORIGIN, step
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import GetParameters, SetParameters

from diffbot_control.law.controller import ControllerConfig, ControllerMemory
from diffbot_control.law.presets import PRESETS
from diffbot_control.law.regions import OMEGA_L, Switching
from diffbot_control.ros.parameters.controller import CONTROLLER_PRESETS, ControllerNodeConfig
from diffbot_core.geometry import Pose
from diffbot_core.schema import build, parameters_of, to_dict

FIELDS = {
    ParameterType.PARAMETER_BOOL: "bool_value",
    ParameterType.PARAMETER_INTEGER: "integer_value",
    ParameterType.PARAMETER_DOUBLE: "double_value",
    ParameterType.PARAMETER_STRING: "string_value",
}


@pytest.mark.parametrize("name", PRESETS)
def test_every_preset_is_valid_and_survives_conversion_to_parameters(name):
    preset = PRESETS[name]
    assert build(ControllerConfig, to_dict(preset)) == preset
    whole = CONTROLLER_PRESETS[name]
    assert whole.preset == name
    assert whole.supervisor.controller == preset
    assert build(ControllerNodeConfig, to_dict(whole)) == whole
    # Whatever is the default, a preset used as the base gives that preset.
    assert build(ControllerNodeConfig, {}, whole) == whole
    assert build(ControllerNodeConfig, {"k": 7}, whole).supervisor.controller.gains.k == 7.0


@pytest.mark.parametrize(("name", "reached"), [("tuned", False), ("paper_covariance", False), ("paper", True)])
def test_only_the_papers_preset_accepts_the_lateral_error_of_its_fixed_region(name, reached):
    """The paper's own end state of simulation A, y = 0.1049 m; see docs/explanation/law/paper.md."""
    memory = ControllerMemory(Switching(OMEGA_L))
    for _ in range(4):
        memory, _, _ = step(memory, Pose(0.0028, 0.1049, 0.0066), ORIGIN, 0.1, PRESETS[name])
    assert memory.reached is False
    memory, _, _ = step(memory, Pose(0.0028, 0.1049, 0.0066), ORIGIN, 0.1, PRESETS[name])
    assert memory.reached is reached


def parameters(peer, name, names):
    answer = peer.call(GetParameters, f"{name}/get_parameters", GetParameters.Request(names=names))
    return {one: getattr(value, FIELDS[value.type]) for one, value in zip(names, answer.values, strict=True)}


def set_parameter(peer, name, **value):
    request = SetParameters.Request(parameters=[Parameter(name=name, value=ParameterValue(**value))])
    return peer.call(SetParameters, "controller/set_parameters", request).results[0]


@pytest.mark.graph
def test_the_node_takes_its_defaults_from_the_preset_and_overrides_win():
    # The order on the command line does not matter: the preset comes last here.
    with graph.node(graph.MODULES["controller"], {"k": 2.0, "preset": "paper"}) as process, graph.peer() as peer:
        process.wait_for_output("ready")
        names = [parameter.name for parameter in parameters_of(ControllerNodeConfig)]
        expected = {**to_dict(CONTROLLER_PRESETS["paper"]), "k": 2.0}
        assert parameters(peer, "controller", names) == expected
        # It is read once: a later change would leave the others as they are.
        refused = set_parameter(peer, "preset", type=ParameterType.PARAMETER_STRING, string_value="tuned")
        assert not refused.successful
        assert "read-only" in refused.reason
        # A later change of another parameter leaves the rest of the preset alone.
        assert set_parameter(peer, "k_2", type=ParameterType.PARAMETER_DOUBLE, double_value=3.25).successful
        assert parameters(peer, "controller", names) == {**expected, "k_2": 3.25}
