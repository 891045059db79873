"""`diffbot run` with a parameter file: the controller needs the limits of its robot, or a plant that is this robot."""

import graph
import pytest

from diffbot_core.errors import DiffbotError
from diffbot_tools import cli
from diffbot_tools.bringup import REQUIRED, check_limits

LIMITS = dict(zip(REQUIRED, (0.6, 1.5, 0.5, 2.0), strict=True))
ROBOT, WITH_PLANT = ("ekf", "controller"), ("ekf", "controller", "plant")


@pytest.fixture
def file(tmp_path):
    """Return a function that writes sections to a file and returns the ROS arguments that name it."""

    def write(name="robot.yaml", **sections):
        lines = []
        for node, values in sections.items():
            lines += [f"{'/**' if node == 'all' else f'/**/{node}'}:", "  ros__parameters:"]
            lines += [f"    {key}: {value}" for key, value in values.items()]
        (tmp_path / name).write_text("\n".join(lines) + "\n")
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


@pytest.mark.parametrize("sections", [{"ekf": {}}, {"plant": LIMITS}, {"controller": {"command_latency": 0.2}}])
def test_a_controller_without_limits_is_refused_without_a_plant(file, sections):
    with pytest.raises(DiffbotError) as error:
        check_limits(ROBOT, file(**sections))
    text = str(error.value)
    assert "\n" not in text
    assert f"the controller has no {', '.join(REQUIRED)}, and no plant runs in this process" in text


def test_the_command_says_so_in_one_line_before_anything_moves(file, kept_signal_handlers, capfd):
    words = file(controller={"command_latency": 0.2})
    assert cli.main(["run", "robot", "--with", "plant", "--ros-args", *words]) == 1
    out, err = capfd.readouterr()
    assert (out, err.count("\n")) == ("", 1)
    assert err.startswith("diffbot: the controller has no linear.x.max_velocity")
    assert "A robot is not driven without its limits" in err


def test_a_plant_that_is_the_same_robot_is_driven(file):
    check_limits(WITH_PLANT, file(plant={"eps_v_max": 0.065}))
    check_limits(WITH_PLANT, file(all={"wheel_radius": 0.1, "command_latency": 0.2}))


def test_a_plant_that_is_another_robot_is_not_driven_without_limits(file):
    """What a calibration used to write: of the controller no limit, of the plant nothing."""
    with pytest.raises(DiffbotError, match=r"the plant is another robot: command_latency 0.2 and 0"):
        check_limits(WITH_PLANT, file(controller={"command_latency": 0.2}))
    with pytest.raises(DiffbotError, match=r"another robot: wheel_radius 0.1 and 0.05"):
        check_limits(WITH_PLANT, file(ekf={"wheel_radius": 0.1}))
    with pytest.raises(DiffbotError, match=r"another robot: .*linear\.x\.max_acceleration inf and 0\.5"):
        check_limits(WITH_PLANT, file(plant=LIMITS))
    check_limits(WITH_PLANT, file(controller={"command_latency": 0.2, **LIMITS}))


def test_sections_and_arguments_of_another_name_do_not_count(file):
    words = file(all=LIMITS)
    check_limits(ROBOT, [*words, "-r", "__ns:=/robot1"])
    with pytest.raises(DiffbotError, match="has no linear"):
        check_limits(ROBOT, [*file(controller=LIMITS), "-r", "controller:__node:=pilot"])
    singles = [word for name in REQUIRED for word in ("-p", f"ekf:{name}:=1.0")]
    with pytest.raises(DiffbotError, match="has no linear"):
        check_limits(ROBOT, [*file("ekf.yaml", ekf={"gate_probability": 0.99}), *singles])


def test_a_controller_without_a_parameter_file_is_run_and_the_limits_that_it_has_are_named(capsys):
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
        (["-p", "uri:=bag"], "-p = 'uri:=bag': no node of this process has the parameter uri"),
        (["-p", "pilot:gamma:=1.0"], "-p = 'pilot:gamma:=1.0': no node pilot runs in this process, only"),
        (["-r", "__ns:=/r1", "-p", "plant:seed:=3"], "-p = 'plant:seed:=3': ROS ignores it for a node in a namespace"),
    ],
)
def test_a_parameter_that_no_node_uses_ends_the_start_in_one_line(words, line):
    with graph.diffbot("run", "robot", "--with", "plant", "--ros-args", *words) as process:
        assert process.wait() == 1
        (error,) = [one for one in process.output.splitlines() if one.startswith("error: ")]
        assert line in error
        assert "]: ready" not in process.output
