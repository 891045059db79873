"""The ready-made controllers, and the parameter of the node that chooses one."""

import one_process
import pytest
from driven import ORIGIN, step
from rclpy.parameter import Parameter

from diffbot_control.controller_node import ControllerNode
from diffbot_control.law.controller import ControllerConfig, ControllerMemory
from diffbot_control.law.presets import PRESETS
from diffbot_control.law.regions import OMEGA_L, Switching
from diffbot_control.ros.parameters.controller import CONTROLLER_PRESETS, ControllerNodeConfig
from diffbot_core.geometry import Pose
from diffbot_core.schema import build, to_dict


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
    """The paper's own end state of simulation A, y = 0.1049 m; see docs/explanation/law.md."""
    memory = ControllerMemory(Switching(OMEGA_L))
    for _ in range(4):
        memory, _, _ = step(memory, Pose(0.0028, 0.1049, 0.0066), ORIGIN, 0.1, PRESETS[name])
    assert memory.reached is False
    memory, _, _ = step(memory, Pose(0.0028, 0.1049, 0.0066), ORIGIN, 0.1, PRESETS[name])
    assert memory.reached is reached


@pytest.mark.graph
def test_the_node_takes_its_defaults_from_the_preset_and_overrides_win():
    with one_process.nodes() as nodes:
        node = nodes.add(ControllerNode, {"k": 2.0, "preset": "paper"})
        expected = {**to_dict(CONTROLLER_PRESETS["paper"]), "k": 2.0}
        assert to_dict(node.config) == expected
        assert {name: node.get_parameter(name).value for name in expected} == expected
        # A later change of another parameter leaves the rest of the preset alone.
        assert node.set_parameters([Parameter("k_2", value=3.25)])[0].successful
        assert to_dict(node.config) == {**expected, "k_2": 3.25}
