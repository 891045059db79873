"""`diffbot run`: a controller needs the limits of its robot, or a plant that is the same robot."""

import graph
import pytest
import yaml

from diffbot_core.errors import DiffbotError
from diffbot_tools import cli
from diffbot_tools.bringup import REQUIRED, check_limits

LIMITS = dict(zip(REQUIRED, (0.6, 1.5, 0.5, 2.0), strict=True))
ROBOT, WITH_PLANT = ("ekf", "controller"), ("ekf", "controller", "plant")


def singles(node):
    """Return ROS arguments that set the limits of a node; an empty name means all nodes."""
    return [word for name in REQUIRED for word in ("-p", f"{node}:{name}:=1.0".lstrip(":"))]


@pytest.fixture
def file(tmp_path):
    """Return a function that writes a parameter file and returns the ROS arguments with its path."""

    def write(sections):
        names = {node: "/**" if node == "all" else f"/**/{node}" for node in sections}
        content = {names[node]: {"ros__parameters": values} for node, values in sections.items()}
        (tmp_path / "robot.yaml").write_text(yaml.safe_dump(content))
        return ["--params-file", str(tmp_path / "robot.yaml")]

    return write


@pytest.mark.parametrize(
    ("nodes", "sections", "arguments"),
    [
        (ROBOT, {"all": LIMITS}, ["-r", "__ns:=/robot1"]),
        (ROBOT, {"controller": {"command_latency": 0.2}}, singles("controller")),
        (ROBOT, {"ekf": {"wheel_radius": 0.1}}, singles("")),
        (("ekf", "recorder"), {"ekf": {"wheel_radius": 0.1}}, []),
        # A plant that is the same robot.
        (WITH_PLANT, {"plant": {"eps_v_max": 0.065}}, []),
        (WITH_PLANT, {"all": {"command_latency": 0.2}}, []),
    ],
)
def test_a_controller_with_the_limits_of_its_robot_is_run(file, nodes, sections, arguments, capsys):
    check_limits(nodes, [*file(sections), *arguments])
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize(
    ("nodes", "sections", "arguments", "reason"),
    [
        (ROBOT, {"plant": LIMITS}, [], "no plant runs in this process"),
        (ROBOT, {"ekf": {"wheel_radius": 0.1}}, singles("ekf"), "no plant runs in this process"),
        (ROBOT, {"controller": LIMITS}, ["-r", "controller:__node:=pilot"], "no plant runs in this process"),
        (
            WITH_PLANT,
            {"controller": {"command_latency": 0.2}},
            [],
            "the plant has another data sheet: command_latency 0.2 and 0",
        ),
        (WITH_PLANT, {"ekf": {"wheel_radius": 0.1}}, [], "the plant has another data sheet: wheel_radius 0.1 and 0.05"),
        (WITH_PLANT, {"plant": LIMITS}, [], "linear.x.max_acceleration inf and 0.5"),
    ],
)
def test_a_controller_without_the_limits_of_its_robot_is_refused(file, nodes, sections, arguments, reason):
    with pytest.raises(DiffbotError) as error:
        check_limits(nodes, [*file(sections), *arguments])
    assert str(error.value).startswith(f"the controller has no {', '.join(REQUIRED)}, and ")
    assert reason in str(error.value)


def test_the_command_refuses_missing_limits_in_one_line(file, kept_signal_handlers, capfd):
    words = file({"controller": {"command_latency": 0.2}})
    assert cli.main(["run", "robot", "--with", "plant", "--ros-args", *words]) == 1
    out, err = capfd.readouterr()
    assert (out, err.count("\n")) == ("", 1)
    assert err.startswith("diffbot: the controller has no linear.x.max_velocity")


def test_without_a_parameter_file_the_default_limits_are_reported(capsys):
    check_limits(WITH_PLANT, [])
    assert capsys.readouterr().err == ""
    check_limits(ROBOT, ["-p", "controller:linear.x.max_velocity:=0.5"])
    text = capsys.readouterr().err
    assert text.startswith(
        "diffbot: no --params-file describes the robot: it is driven with angular.z.max_velocity 2.6"
    )
    assert "linear.x" not in text.partition(",")[0]
    assert text.count("\n") == 1


@pytest.mark.graph
@pytest.mark.parametrize(
    ("words", "line"),
    [
        (
            ["-p", "linear.x.max_velocty:=0.5"],
            "no node of this process has the parameter linear.x.max_velocty: must be a known name",
        ),
        (["-p", "ekf:gama:=2.0"], "-p = 'ekf:gama:=2.0': ekf has no parameter gama"),
        (["-p", "pilot:gamma:=1.0"], "-p = 'pilot:gamma:=1.0': no node pilot runs in this process, only"),
        (["-r", "__ns:=/r1", "-p", "plant:seed:=3"], "-p = 'plant:seed:=3': ROS ignores it for a node in a namespace"),
    ],
)
def test_a_parameter_that_no_node_uses_is_refused_in_one_line(words, line):
    with graph.diffbot("run", "robot", "--with", "plant", "--ros-args", *words) as process:
        assert process.wait() == 1
        (error,) = [one for one in process.output.splitlines() if one.startswith("error: ")]
        assert line in error
        assert "]: ready" not in process.output
