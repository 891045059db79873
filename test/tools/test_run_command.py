"""`diffbot run`: a controller needs the limits of its robot, or a plant that is the same robot."""

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
        (WITH_PLANT, {"plant": {"eps_v_max": 0.065}, "all": {"command_latency": 0.2}}, []),
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
        (WITH_PLANT, {"controller": {"command_latency": 0.2}}, [], "has another data sheet: command_latency 0.2 and 0"),
        (WITH_PLANT, {"ekf": {"wheel_radius": 0.1}}, [], "has another data sheet: wheel_radius 0.1 and 0.05"),
        (WITH_PLANT, {"plant": LIMITS}, [], "linear.x.max_acceleration inf and 0.5"),
    ],
)
def test_a_controller_without_the_limits_of_its_robot_is_refused(file, nodes, sections, arguments, reason):
    with pytest.raises(DiffbotError) as error:
        check_limits(nodes, [*file(sections), *arguments])
    assert str(error.value).startswith(f"the controller has no {', '.join(REQUIRED)}, and ")
    assert reason in str(error.value)


def test_docking_needs_the_limits_of_the_robot_too(file, capsys, kept_signal_handlers):
    # The dock_controller drives to its staging pose with the limits of its own data sheet.
    arguments = ["--ros-args", *file({"controller": LIMITS, "dock_ekf": {"docked_x": -0.35}})]
    assert cli.main(["run", "docking", *arguments]) == 1
    assert capsys.readouterr().err.startswith(f"diffbot: the dock_controller has no {REQUIRED[0]}, ")
    check_limits(("dock_ekf", "dock_controller"), file({"all": LIMITS}))


def test_without_a_parameter_file_the_default_limits_are_reported(capsys):
    check_limits(WITH_PLANT, [])
    assert capsys.readouterr().err == ""
    check_limits(ROBOT, ["-p", "controller:linear.x.max_velocity:=0.5"])
    (line,) = capsys.readouterr().err.splitlines()
    start = "diffbot: no --params-file describes the robot: it is driven with angular.z.max_velocity 2.6"
    assert line.startswith(start), "linear.x.max_velocity is given"


def test_lockstep_sets_what_its_nodes_need_and_refuses_two_controllers(capsys, monkeypatch, kept_signal_handlers):
    given = []
    monkeypatch.setattr("diffbot_core.ros.run.run", lambda _make, words, **_: given.extend(words) or 0)
    lockstep = ["--ros-args", "-p", "clock:=lockstep"]
    assert cli.main(["run", "ekf", "--with", "plant", *lockstep]) == 0
    assert set(given[2:-2:2]) == {'cmd_vel_type:="twist_stamped"', "reliable_inputs:=true", "use_sim_time:=true"}
    assert cli.main(["run", "robot", "--with", "plant", "docking", *lockstep]) == 1
    assert "only one node may publish cmd_vel" in capsys.readouterr().err


def test_a_robot_in_a_namespace_has_its_own_tf_unless_its_frames_have_a_prefix(monkeypatch, kept_signal_handlers):
    from rclpy.context import Context
    from rclpy.node import Node

    given = []
    monkeypatch.setattr("diffbot_core.ros.run.run", lambda _make, words, **_: given.append(words) or 0)
    arguments = ["run", "ekf", "--with", "plant", "recorder", "--ros-args"]
    own = ["-r", "ekf:/tf:=tf", "-r", "ekf:/tf_static:=tf_static"]
    own += ["-r", "plant:/tf:=tf", "-r", "plant:/tf_static:=tf_static"]
    namespace, prefix = ["-r", "__ns:=/robot1"], ["-p", "frame_prefix:=robot1/"]
    for words, added in (([], []), (namespace, own), ([*namespace, *prefix], [])):
        assert cli.main([*arguments, *words]) == 0
        assert given[-1] == ["--ros-args", *words, *added]
    context = Context()
    context.init(given[1])
    for name, topic in (("plant", "/robot1/tf"), ("recorder", "/tf")):
        node = Node(name, context=context)
        assert node.resolve_topic_name("/tf") == topic
        node.destroy_node()
    context.shutdown()


def test_only_recorder_and_replay_have_shared_memory(monkeypatch, kept_signal_handlers):
    given = []
    monkeypatch.setattr("diffbot_core.ros.run.run", lambda *_, **options: given.append(options["shared_memory"]) or 0)
    for nodes in (["recorder"], ["recorder", "--with", "ekf"], ["plant"]):
        assert cli.main(["run", *nodes]) == 0
    assert given == [True, False, False]


@pytest.mark.graph
@pytest.mark.parametrize(
    ("words", "line"),
    [
        (["-p", "sigma_known:=-1.0"], "error: /controller: sigma_known = -1.0: must be >= 0.0001 and <= 10"),
        (["-p", "linear.x.max_velocty:=0.5"], "error: -p = 'linear.x.max_velocty:=0.5': no node of this "),
        (["-p", "ekf:gama:=2.0"], "error: -p = 'ekf:gama:=2.0': ekf has no parameter gama"),
        (["-p", "pilot:gamma:=1.0"], "error: -p = 'pilot:gamma:=1.0': no node pilot runs in this process, only"),
        (
            ["-r", "__ns:=/r1", "-p", "plant:seed:=3"],
            "error: -p = 'plant:seed:=3': ROS ignores it for a node in a namespace",
        ),
        ({"controller": {"command_latency": 0.2}}, "diffbot: the controller has no linear.x.max_velocity"),
    ],
)
def test_wrong_parameters_end_the_command_in_one_line(words, line, file, kept_signal_handlers, capfd, monkeypatch):
    monkeypatch.setenv("FASTDDS_BUILTIN_TRANSPORTS", "UDPv4")  # the nodes set it
    arguments = words if isinstance(words, list) else file(words)
    assert cli.main(["run", "robot", "--with", "plant", "--ros-args", *arguments]) == 1
    printed = "".join(capfd.readouterr())
    (error,) = [one for one in printed.splitlines() if not one.startswith("[INFO]")]
    assert error.startswith(line)
    assert "]: ready" not in printed
