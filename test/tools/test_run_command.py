"""`diffbot run`: a controller needs the limits of its robot, or a plant that is the same robot."""

import graph
import pytest
import yaml

from diffbot_core.errors import DiffbotError
from diffbot_tools import cli
from diffbot_tools.bringup import REQUIRED, check_limits

LIMITS = dict(zip(REQUIRED, (0.6, 1.5, 0.5, 2.0), strict=True))
ROBOT, WITH_PLANT = ("ekf", "controller"), ("ekf", "controller", "plant")


@pytest.fixture
def file(tmp_path):
    """Return a function that writes a parameter file and returns the ROS arguments with its path."""

    def write(name="robot.yaml", **sections):
        content = {
            f"/**{'' if node == 'all' else f'/{node}'}": {"ros__parameters": values}
            for node, values in sections.items()
        }
        (tmp_path / name).write_text(yaml.safe_dump(content))
        return ["--params-file", str(tmp_path / name)]

    return write


def test_limits_count_wherever_they_are_given(file):
    check_limits(ROBOT, file(all=LIMITS))
    check_limits(ROBOT, [*file(all=LIMITS), *file("calibrated.yaml", controller={"command_latency": 0.2})])
    some = {name: LIMITS[name] for name in REQUIRED[:2]}
    for scope in ("", "controller:"):
        singles = [word for name in REQUIRED[2:] for word in ("-p", f"{scope}{name}:=1.0")]
        check_limits(ROBOT, [*file(controller=some), *singles])
    check_limits(("ekf", "recorder"), file(ekf={"gate_probability": 0.99}))


@pytest.mark.parametrize("sections", [{"plant": LIMITS}, {"controller": {"command_latency": 0.2}}])
def test_a_controller_without_limits_is_refused_without_a_plant(file, sections):
    with pytest.raises(DiffbotError) as error:
        check_limits(ROBOT, file(**sections))
    assert f"the controller has no {', '.join(REQUIRED)}, and no plant runs in this process" in str(error.value)


def test_the_command_refuses_missing_limits_in_one_line(file, kept_signal_handlers, capfd):
    words = file(controller={"command_latency": 0.2})
    assert cli.main(["run", "robot", "--with", "plant", "--ros-args", *words]) == 1
    out, err = capfd.readouterr()
    assert (out, err.count("\n")) == ("", 1)
    assert err.startswith("diffbot: the controller has no linear.x.max_velocity")


@pytest.mark.parametrize("sections", [{"plant": {"eps_v_max": 0.065}}, {"all": {"command_latency": 0.2}}])
def test_without_limits_a_plant_that_is_the_same_robot_is_driven(file, sections):
    check_limits(WITH_PLANT, file(**sections))


@pytest.mark.parametrize(
    ("sections", "difference"),
    [
        ({"controller": {"command_latency": 0.2}}, r"command_latency 0.2 and 0"),
        ({"ekf": {"wheel_radius": 0.1}}, r"wheel_radius 0.1 and 0.05"),
        ({"plant": LIMITS}, r".*linear\.x\.max_acceleration inf and 0\.5"),
    ],
)
def test_without_limits_a_plant_that_is_another_robot_is_not_driven(file, sections, difference):
    with pytest.raises(DiffbotError, match=f"the plant is another robot: {difference}"):
        check_limits(WITH_PLANT, file(**sections))


def test_limits_of_another_node_do_not_count(file):
    words = file(all=LIMITS)
    check_limits(ROBOT, [*words, "-r", "__ns:=/robot1"])
    with pytest.raises(DiffbotError, match="has no linear"):
        check_limits(ROBOT, [*file(controller=LIMITS), "-r", "controller:__node:=pilot"])
    singles = [word for name in REQUIRED for word in ("-p", f"ekf:{name}:=1.0")]
    with pytest.raises(DiffbotError, match="has no linear"):
        check_limits(ROBOT, [*file("ekf.yaml", ekf={"gate_probability": 0.99}), *singles])


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
