"""Parameters of the nodes: what is refused at the start and later, in which words, and what takes effect."""

import math
import subprocess
import sys
from pathlib import Path

import graph
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from graph import MODULES
from nav_msgs.msg import Odometry
from rcl_interfaces.msg import Parameter
from rcl_interfaces.srv import GetParameters, SetParameters, SetParametersAtomically
from robot import parameter_value, planar, robot

from diffbot_bag.parameters import RecorderConfig, ReplayConfig
from diffbot_control.controller_node import ControllerNodeConfig
from diffbot_control.ekf_node import EkfNodeConfig
from diffbot_core.schema import parameters_of
from diffbot_sim.plant_node import PlantNodeConfig

CONFIGS = {"plant": PlantNodeConfig, "ekf": EkfNodeConfig, "controller": ControllerNodeConfig}
ALL_MODULES = {**MODULES, "recorder": "diffbot_bag.recorder_node", "replay": "diffbot_bag.replay_node"}

AT_START = [
    ("controller", ["-p", "gamma:=-1.0"], ["gamma = -1.0", ">= 1e-06 and <= 1000"]),
    ("controller", ["-p", "k:=.nan"], ["k = nan", ">= 1e-06 and <= 1000"]),
    ("controller", ["-p", "wheel_radius:=-0.05"], ["wheel_radius = -0.05", ">= 0.001 and <= 10"]),
    ("controller", ["-p", "eps_P:=0.5", "-p", "eps_P_leave:=0.4"], ["eps_P_leave = 0.4", ">= eps_P = 0.5"]),
    ("controller", ["-p", "hold_goal:=1"], ["hold_goal = 1", "true or false"]),
    ("controller", ["-p", "pose_source:=tf"], ["pose_source = 'tf'", "one of pose, odometry"]),
    (
        "controller",
        ["-p", "follow_covariance:=true"],
        ["follow_covariance = True: was replaced by region_policy (fixed or covariance)"],
    ),
    ("controller", ["-p", "region_policy:=circle"], ["region_policy = 'circle'", "one of fixed, covariance"]),
    ("controller", ["-p", "region_policy:=1"], ["region_policy = 1", "a text"]),
    ("controller", ["-p", "pose_sigma_xy:=0.0"], ["pose_sigma_xy = 0.0", ">= 0.0001"]),
    ("controller", ["-p", "use_sim_time:=1"], ["use_sim_time"]),
    ("ekf", ["-p", "wheel_separation:=0.0"], ["wheel_separation = 0.0", ">= 0.001 and <= 10"]),
    ("ekf", ["-p", "wheel_separation:=5.0e-324"], ["wheel_separation = 5e-324", ">= 0.001 and <= 10"]),
    ("ekf", ["-p", "odometry_source:=stars"], ["odometry_source = 'stars'", "one of odom, joint_states"]),
    ("plant", ["-p", "eps_omega_max:=1.0e+308"], ["eps_omega_max = 1e+308", ">= 0 and <= 1000"]),
    ("plant", ["-p", "clock:=sundial"], ["clock = 'sundial'", "one of wall, scaled, lockstep"]),
    ("plant", ["-p", "start_time:=3e9"], ["start_time = 3000000000.0", "<= 2e+09"]),
    ("recorder", ["-p", "compression:=rar"], ["compression = 'rar'", "one of zstd, lz4, none"]),
    ("replay", ["-p", "rate:=0.0"], ["rate = 0.0", ">= 1e-06 and <= 1e+06"]),
    ("controller", ["--params-file", "/nowhere/at/all.yaml"], ["invalid arguments", "/nowhere/at/all.yaml"]),
    ("controller", ["--params-file", __file__], ["invalid arguments", __file__]),
    ("controller", ["--nonsense"], ["invalid arguments", "--nonsense"]),
]


def start_all(cases):
    """Start them at the same time, few at once; return exit status and output of each."""
    results = []
    for first in range(0, len(cases), 4):
        running = [
            subprocess.Popen(
                [sys.executable, "-m", ALL_MODULES[name], "--ros-args", *arguments],
                env=graph.environment(),
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
                text=True,
            )
            for name, arguments, _ in cases[first : first + 4]
        ]
        try:
            results += [(*process.communicate(timeout=60.0), process.returncode) for process in running]
        finally:
            for process in running:
                process.kill()
                process.communicate()
    return results


def test_nodes_refuse_to_start_in_one_line_that_names_parameter_value_and_bound():
    for (name, arguments, words), (out, errors, status) in zip(AT_START, start_all(AT_START), strict=True):
        assert status == 1, (name, arguments, errors)
        lines = [line for line in (out + errors).splitlines() if line]
        assert len(lines) == 1, (name, arguments, lines)
        assert lines[0].startswith("error: ")
        assert all(word in lines[0] for word in words), (lines[0], words)


@pytest.fixture(scope="module")
def nodes():
    controller = {"unheard_of": 1.0, "gamma": 1}
    with robot({"clock": "scaled", "real_time_factor": 5.0}, controller=controller) as running:
        yield running


def set_parameters(nodes, node, values, service=SetParameters):
    parameters = [Parameter(name=name, value=parameter_value(value)) for name, value in values.items()]
    return nodes.peer.call(
        service,
        f"{node}/{'set_parameters'}{'_atomically' * (service is not SetParameters)}",
        service.Request(parameters=parameters),
    )


def get_parameter(nodes, node, name):
    value = nodes.peer.call(GetParameters, f"{node}/get_parameters", GetParameters.Request(names=[name])).values[0]
    fields = (None, "bool", "integer", "double", "string", "byte_array", "bool_array", "integer_array", "double_array")
    return None if value.type == 0 else getattr(value, f"{fields[value.type]}_value")


def bad_values(parameter):
    """Values that no parameter of this type and range takes."""
    if parameter.type is bool:
        return [1, "yes", None, 0.5]
    if parameter.type is str:
        return [5, None, *(["surely not one of them"] if parameter.spec.choices else [])]
    below = [] if parameter.spec.minimum == -math.inf else [parameter.spec.minimum - 1]
    above = [] if parameter.spec.maximum == math.inf else [parameter.spec.maximum * 2 + 1]
    if parameter.type is int:
        return [0.5, "x", None, True, *(int(number) for number in below + above if abs(number) < 2**62)]
    endless = [] if parameter.spec.allow_inf else [math.inf]
    return [math.nan, -math.inf, "x", None, True, [1.0, 2.0], *endless, *map(float, below + above)]


@pytest.mark.parametrize("node", CONFIGS)
def test_bad_changes_are_refused_in_words_and_change_nothing(nodes, node):
    for parameter in parameters_of(CONFIGS[node]):
        before = get_parameter(nodes, node, parameter.name)
        assert before is not None, parameter.name
        for value in bad_values(parameter):
            result = set_parameters(nodes, node, {parameter.name: value}).results[0]
            assert not result.successful, (parameter.name, value)
            assert parameter.name in result.reason
            if not parameter.spec.read_only:
                assert f"{parameter.name} = {value!r}: must be " in result.reason
        assert get_parameter(nodes, node, parameter.name) == before
    assert all(process.popen.poll() is None for process in nodes.processes.values())


@pytest.mark.parametrize("node", CONFIGS)
def test_read_only_parameters_are_refused_whatever_the_value(nodes, node):
    read_only = [parameter for parameter in parameters_of(CONFIGS[node]) if parameter.spec.read_only]
    assert read_only
    for parameter in read_only:
        before = get_parameter(nodes, node, parameter.name)
        result = set_parameters(nodes, node, {parameter.name: parameter.default}).results[0]
        assert not result.successful, parameter.name
        assert "read-only" in result.reason
        assert get_parameter(nodes, node, parameter.name) == before


def test_what_holds_between_parameters_is_kept_and_both_can_change_at_once(nodes):
    refused = set_parameters(nodes, "controller", {"eps_P_leave": 0.3}).results[0]
    assert not refused.successful
    assert refused.reason == "eps_P_leave = 0.3: must be >= eps_P = 0.5"
    both = set_parameters(nodes, "controller", {"eps_P": 0.2, "eps_P_leave": 0.3}, SetParametersAtomically).result
    assert both.successful, both.reason
    assert get_parameter(nodes, "controller", "eps_P") == 0.2
    half = set_parameters(nodes, "controller", {"eps_P": 0.25, "eps_P_leave": 0.1}, SetParametersAtomically).result
    assert not half.successful
    assert get_parameter(nodes, "controller", "eps_P") == 0.2


def test_good_changes_take_effect(nodes):
    """Omega_L: omega = -k_2 theta; and a bound of v that the speed then keeps."""
    nodes.send_goal(20.0, 0.0, 0.0)
    nodes.peer.spin_until(lambda: nodes.commands and nodes.commands[-1].linear.x > 0.6, 8.0, "motion")
    assert set_parameters(nodes, "controller", {"linear.x.max_velocity": 0.25}).results[0].successful
    nodes.peer.spin_until(lambda: abs(nodes.commands[-1].linear.x) <= 0.25, 3.0, "the lower speed")
    nodes.peer.spin_for(0.3)
    assert nodes.commands[-1].linear.x == pytest.approx(0.25, rel=0.05)
    assert set_parameters(nodes, "controller", {"linear.x.max_velocity": math.inf}).results[0].successful
    assert set_parameters(nodes, "plant", {"fix_rate": 0.0}).results[0].successful
    nodes.peer.spin_for(0.3)
    before = nodes.diagnosis("plant")
    after = nodes.diagnosis("plant")
    assert int(after["odom sent"]) > int(before["odom sent"])
    assert after["global_pose sent"] == before["global_pose sent"]
    assert set_parameters(nodes, "plant", {"fix_rate": 10.0}).results[0].successful


def test_a_whole_number_is_taken_for_a_float_at_the_start_and_later(nodes):
    assert set_parameters(nodes, "controller", {"gamma": 2}).results[0].successful
    assert set_parameters(nodes, "controller", {"gamma": 1.3}).results[0].successful


def test_a_misspelt_parameter_is_said_in_the_log(nodes):
    output = nodes.processes["controller"].output
    assert output.count("unknown parameter 'unheard_of' is ignored") == 1
    assert "unknown parameter" not in nodes.processes["plant"].output


def test_pose_timeout_changes_the_watch_and_a_tiny_one_does_not_take_the_processor():
    with (
        graph.node(MODULES["controller"], {"pose_timeout": 1e-3}, ("-r", "__ns:=/tiny")) as process,
        graph.peer() as peer,
    ):
        process.wait_for_output("ready")
        heard = peer.subscribe(DiagnosticArray, "/diagnostics")
        peer.spin_until(lambda: [one for one in heard if one.status[0].name == "/tiny/controller"], 5.0, "diagnostics")
        used = cpu_seconds(process.popen.pid)
        peer.spin_for(1.0)
        assert cpu_seconds(process.popen.pid) - used < 0.6


def cpu_seconds(pid):
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / 100.0


def test_a_parameter_file_counts_for_the_node_it_names(tmp_path):
    file = tmp_path / "start.yaml"
    file.write_text("/**/plant:\n  ros__parameters:\n    initial_pose.x: 3\n    initial_pose.yaw: 0.0\n")
    with robot(only=()) as empty:
        arguments = ("--params-file", str(file), "-r", "__ns:=/filed", "-p", "initial_pose.y:=4.5")
        with graph.node(MODULES["plant"], arguments=arguments) as process:
            process.wait_for_output("ready")
            truths = empty.peer.subscribe(Odometry, "/filed/ground_truth")
            empty.peer.spin_until(lambda: truths, 5.0, "the truth")
    assert planar(truths[0].pose.pose) == (3.0, 4.5, 0.0)


def test_no_two_nodes_disagree_about_a_shared_default():
    shared = {}
    for config in (*CONFIGS.values(), RecorderConfig, ReplayConfig):
        for parameter in parameters_of(config):
            if parameter.name in ("wheel_radius", "wheel_separation", "map_frame", "odom_frame", "base_link_frame"):
                shared.setdefault(parameter.name, set()).add(parameter.default)
    assert all(len(defaults) == 1 for defaults in shared.values()), shared
