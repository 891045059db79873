"""Parameters of the controller with a custom law, and laws that the controller refuses."""

import sys
from typing import Annotated, NamedTuple

import pytest

from diffbot_control.law import PRESETS, GoalTolerance, Law, SwitchingLaw
from diffbot_control.ros.parameters.controller import ControllerNodeConfig, parameter_set_of
from diffbot_core.data_sheet import DataSheet
from diffbot_core.errors import InvalidValueError
from diffbot_core.schema import Spec, build, parameters_of, to_dict
from diffbot_lab.laws.rotate_drive_rotate import RotateDriveRotateConfig


class Gain(NamedTuple):
    gain: Annotated[float, Spec("a gain", "-", 0.0, 2.0)] = 1.5
    bare: float = 3.0
    remark: Annotated[str, "no Spec"] = "x"
    data_sheet: DataSheet = DataSheet()


class Clash(NamedTuple):
    hold_goal: Annotated[float, Spec("a name that the node has")] = 1.0


class Simulated(NamedTuple):
    use_sim_time: Annotated[bool, Spec("a name that every node has")] = False


class Complex(NamedTuple):
    gain: Annotated[complex, Spec("not a kind of parameter")] = 1j


class Memory(NamedTuple):
    reached: bool = False


def law_with(config):
    """Return the parameter ``law`` for a law with this Config."""
    members = {
        "name": "mine",
        "Config": config,
        "new_memory": staticmethod(lambda _: Memory()),
        "step": staticmethod(lambda memory, observation, goal, config: (memory, None, None)),
        "data_sheet": staticmethod(lambda config: DataSheet()),
        "tolerance": staticmethod(lambda config: GoalTolerance()),
    }
    setattr(sys.modules[__name__], f"Law{config.__name__}", type("Law", (Law,), members))
    return f"{__name__}:Law{config.__name__}"


def test_a_registered_law_brings_its_parameters_and_the_node_keeps_its_own():
    config_type, presets = parameter_set_of({"law": "rotate_drive_rotate"})
    names = {one.name for one in parameters_of(config_type)}
    own = {one.name for one in parameters_of(ControllerNodeConfig)}
    of_laws = {one.name for law in (SwitchingLaw.Config, RotateDriveRotateConfig) for one in parameters_of(law)}
    assert presets is None
    assert names - of_laws == own - of_laws - {"preset"}
    assert {one.name for one in parameters_of(RotateDriveRotateConfig)} <= names
    config = build(config_type, {"command_latency": 0.2, "drive_brake": 2.0, "hold_goal": False})
    controller = config.supervisor.controller
    assert isinstance(controller, RotateDriveRotateConfig)
    assert (controller.data_sheet.command_latency, controller.drive_brake) == (0.2, 2.0)
    assert (config.supervisor.hold_goal, config.supervisor.pose_timeout) == (False, 0.5)


def test_fields_without_a_spec_are_no_parameters_and_keep_their_defaults():
    config_type, _ = parameter_set_of({"law": law_with(Gain)})
    names = {one.name for one in parameters_of(config_type)}
    assert {"gain", "linear.x.max_velocity"} <= names
    assert not {"bare", "remark"} & names
    assert build(config_type, {"gain": 0.5}).supervisor.controller == Gain(gain=0.5)
    with pytest.raises(InvalidValueError, match=r"^gain = 3\.0: must be >= 0 and <= 2$"):
        build(config_type, {"gain": 3.0})


@pytest.mark.parametrize(
    ("config", "reason"),
    [
        (Clash, r"a law with usable parameters \(TypeError: .*used twice: \['hold_goal'\]\)"),
        (Simulated, "a law without a parameter use_sim_time, because every node has one"),
        (Complex, "a law whose parameters are numbers, booleans or texts; gain is not"),
    ],
)
def test_a_law_whose_parameters_the_node_cannot_have_is_refused(config, reason):
    with pytest.raises(InvalidValueError, match=f"must be {reason}$"):
        parameter_set_of({"law": law_with(config)})


@pytest.mark.parametrize(
    ("given", "law", "preset"),
    [
        ({}, "switching", "tuned"),
        ({"preset": "precise"}, "switching", "precise"),
        ({"preset": "paper"}, "paper", "paper"),
        ({"law": "paper"}, "paper", "paper"),
        ({"law": "paper", "preset": "paper"}, "paper", "paper"),
    ],
)
def test_a_preset_selects_its_law_and_a_law_its_preset(given, law, preset):
    config_type, presets = parameter_set_of(given)
    assert ("sigma_known" in {one.name for one in parameters_of(config_type)}) == (law == "switching")
    assert to_dict(config_type()) == {one.name: one.default for one in parameters_of(config_type)}
    found = presets[given.get("preset", config_type().preset)]
    assert (found.law, found.preset) == (law, preset)
    assert found.supervisor.controller == PRESETS[preset].config
    assert build(config_type, given, found) == found


@pytest.mark.parametrize("given", [{"law": "switching", "preset": "paper"}, {"law": "docking", "preset": "tuned"}])
def test_a_preset_of_another_law_is_refused(given):
    with pytest.raises(
        InvalidValueError, match=f"preset = '{given['preset']}': must be a preset of the law {given['law']}: "
    ):
        parameter_set_of(given)
