"""The ready-made controllers, and the node's parameter that chooses between them."""

import subprocess
import sys

import graph
import pytest
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import DescribeParameters, GetParameters, SetParameters

from diffbot_control.law.controller import ControllerConfig
from diffbot_control.law.lyapunov_law import sampled_poles, unstable_gains
from diffbot_control.law.presets import PRESETS
from diffbot_control.ros.controller_parameters import CONTROLLER_PRESETS, ControllerNodeConfig
from diffbot_core.errors import InvalidValueError
from diffbot_core.schema import build, parameters_of, to_dict

CHOICES = "one of " + ", ".join(PRESETS)
FIELDS = {
    ParameterType.PARAMETER_BOOL: "bool_value",
    ParameterType.PARAMETER_INTEGER: "integer_value",
    ParameterType.PARAMETER_DOUBLE: "double_value",
    ParameterType.PARAMETER_STRING: "string_value",
}


@pytest.mark.parametrize("name", PRESETS)
def test_every_preset_is_valid_and_survives_the_way_through_its_parameters(name):
    preset = PRESETS[name]
    assert build(ControllerConfig, to_dict(preset)) == preset
    whole = CONTROLLER_PRESETS[name]
    assert whole.preset == name
    assert whole.supervisor.controller == preset
    assert build(ControllerNodeConfig, to_dict(whole)) == whole
    # Whatever is the default, a preset taken as the base gives that preset.
    assert build(ControllerNodeConfig, {}, whole) == whole
    assert build(ControllerNodeConfig, {"k": 7}, whole).supervisor.controller.gains.k == 7.0


def test_what_the_presets_promise():
    paper, tuned = PRESETS["paper"], PRESETS["tuned"]
    assert set(CONTROLLER_PRESETS) == set(PRESETS) == {"paper", "paper_covariance", "tuned"}
    assert paper.gains == (1.3, 1.0, 0.17, 2.7)
    assert paper.covariance_region.follow_covariance is False
    assert (paper.region.eps_P, paper.tolerance.xy_goal_tolerance) == (0.5, 0.4)
    assert tuned.covariance_region.follow_covariance is True
    assert (tuned.tolerance.xy_goal_tolerance, tuned.tolerance.yaw_goal_tolerance) == (0.1, 0.1)
    assert tuned.reapproach.reapproach_tries > 0
    for preset in PRESETS.values():
        assert unstable_gains(preset.gains, 0.1) == ""
        assert max(sampled_poles(preset.gains, 0.1)) < 1.0
        # The smallest radius that a robot can come into and the way out must fit.
        assert preset.covariance_region.eps_P_leave_min >= preset.covariance_region.eps_P_min


def test_a_preset_that_is_none_is_refused():
    with pytest.raises(InvalidValueError, match=f"preset = 'papre': must be {CHOICES}"):
        build(ControllerNodeConfig, {"preset": "papre"})


def parameters(peer, name, names):
    answer = peer.call(GetParameters, f"{name}/get_parameters", GetParameters.Request(names=names))
    return {one: getattr(value, FIELDS[value.type]) for one, value in zip(names, answer.values, strict=True)}


def expected_of(preset, **changes):
    values = to_dict(CONTROLLER_PRESETS[preset])
    return {**values, **changes}


@pytest.mark.graph
@pytest.mark.parametrize(
    ("preset", "overrides"),
    [("paper", {"k": 2.0}), ("tuned", {}), ("tuned", {"xy_goal_tolerance": 0.03, "reapproach_tries": 7})],
)
def test_the_node_takes_its_defaults_from_the_preset_and_overrides_win(preset, overrides):
    # The order on the command line does not matter: the preset comes last here.
    with graph.node(graph.MODULES["controller"], {**overrides, "preset": preset}) as process, graph.peer() as peer:
        process.wait_for_output("ready")
        names = [parameter.name for parameter in parameters_of(ControllerNodeConfig)]
        found = parameters(peer, "controller", names)
        assert found == expected_of(preset, **overrides)
        if overrides.get("k") == 2.0:
            assert (found["k"], found["h"], found["preset"]) == (2.0, 0.17, "paper")
        # It is read once: a later change would leave the others as they are.
        value = ParameterValue(type=ParameterType.PARAMETER_STRING, string_value="paper")
        request = SetParameters.Request(parameters=[Parameter(name="preset", value=value)])
        refused = peer.call(SetParameters, "controller/set_parameters", request).results[0]
        assert not refused.successful
        assert "read-only" in refused.reason
        described = peer.call(
            DescribeParameters, "controller/describe_parameters", DescribeParameters.Request(names=["preset", "k"])
        ).descriptors
        assert [one.read_only for one in described] == [True, False]
        assert described[0].additional_constraints == CHOICES
        # A later change of another parameter leaves the rest of the preset alone.
        value = ParameterValue(type=ParameterType.PARAMETER_DOUBLE, double_value=3.25)
        request = SetParameters.Request(parameters=[Parameter(name="k_2", value=value)])
        assert peer.call(SetParameters, "controller/set_parameters", request).results[0].successful
        assert parameters(peer, "controller", names) == expected_of(preset, **overrides, k_2=3.25)
        assert "unknown parameter" not in process.output


@pytest.mark.graph
def test_bad_presets_are_refused_at_the_start_in_one_line():
    cases = [
        (["preset:=papre"], f"preset = 'papre': must be {CHOICES}"),
        (["preset:=3"], "preset = 3: must be a text"),
        (["preset:=tuned", "k:=-2.0"], "k = -2.0: must be"),
    ]
    running = []
    for words, _ in cases:
        arguments = [text for word in words for text in ("-p", word)]
        command = [sys.executable, "-m", graph.MODULES["controller"], "--ros-args", *arguments]
        running.append(
            subprocess.Popen(
                command, env=graph.environment(), stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
            )
        )
    try:
        for process, (_, message) in zip(running, cases, strict=True):
            output, _ = process.communicate(timeout=60.0)
            assert process.returncode == 1
            lines = output.splitlines()
            assert len(lines) == 1, output
            assert lines[0].startswith("error: ")
            assert message in lines[0]
    finally:
        for process in running:
            process.kill()
            process.wait()
