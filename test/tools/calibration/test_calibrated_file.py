"""`diffbot calibrate` writes the complete given file with the calibrated values."""

import difflib
import math
from types import SimpleNamespace

import numpy as np
import pytest

from diffbot_control.ros.parameters.controller import ControllerNodeConfig
from diffbot_control.ros.parameters.ekf import EkfNodeConfig
from diffbot_core.schema import build, to_dict
from diffbot_core.yaml_files import read_sections
from diffbot_tools.bringup import check_data_sheet
from diffbot_tools.calibration import parameters
from diffbot_tools.calibration.calibrate import HeldOutFigures
from diffbot_tools.calibration.calibrated_file import calibrated_file
from diffbot_tools.calibration.command import describe
from diffbot_tools.calibration.latency import LatencyEstimate
from diffbot_tools.calibration.parameters import CalibrationResult, Row
from diffbot_tools.calibration.quantities import Quantity
from diffbot_tools.filter_statistics import Consistency
from diffbot_tools.parameter_file import read_config, values_of
from diffbot_tools.robot import read_robot
from diffbot_tools.robot_description import PRESETS, file_of_robot
from diffbot_tools.robot_trial import contradictions

FOUND = CalibrationResult(
    {
        "odometry_delay": 0.21,
        "odometry_noise": "motion",
        "alpha1": 1e-05,
        "global_pose_sigma_xy": 0.0512,
        "use_gyro": True,
    },
    [Row("odometry_delay", 0.0, 0.21, "0.01", ""), Row("alpha1", 1.0, 1e-05, "7 %", "at its bound")],
    [],
)
LATENCY = LatencyEstimate(0.2291, 0.0142, 0.1, 0.5, 9.0)
HEAD = "Calibrated from drive by diffbot calibrate."
FILES = {
    "indented": """\
# my robot

/**:
    ros__parameters:
        # the data sheet
        linear: {x: {max_velocity: 0.6, max_acceleration: 0.9}}
        command_latency: 0.1   # [s] guessed

# the filter
/robot1:
    ekf:
        ros__parameters:
            filter: 'ekf'
            pose_sources:
            - uwb # ceiling
            - gps
            pose_source_sigma_xy: [1.0, 1.0] # in the hall
            correlation_times:
            - 0.0 # of fixes
            # compass
            - 0.5 # guessed
            gate_probability: 1.0
# the end
""",
    "one line": "/**/ekf: {ros__parameters: {gate_probability: 1.0, pose_sources: [uwb, gps], use_gyro: true}}\n",
}


def written(path, text, result=FOUND, latency=LATENCY, head=HEAD):
    """Write ``text`` to ``path``, calibrate the file in place, and return the new text."""
    path.write_text(text)
    config = read_config(path)
    path.write_text(calibrated_file(path, config, result, latency, head))
    return path.read_text()


def values(path, node):
    sections = [one for one in read_sections(path) if one.node in (node, "**")]
    return {name: value for one in sections for name, value in one.values.items()}


def changed_lines(before, after):
    lines = list(difflib.ndiff(before.splitlines(), after.splitlines()))
    return [line[2:].strip() for line in lines if line[0] == "-"], [
        line[2:].strip() for line in lines if line[0] == "+"
    ]


def test_a_robot_s_file_stays_complete_with_its_comments(tmp_path):
    path, before = tmp_path / "calibrated.yaml", file_of_robot(PRESETS["turtlebot4"])
    after = written(path, before)
    removed, added = changed_lines(before, after)
    assert [line.split(":")[0] for line in removed] == [
        *("linear.x.max_acceleration", "command_latency", "drive_time_constant", "global_pose_sigma_xy", "eps_xy_max"),
    ]
    assert [" ".join(line.split()) for line in added] == [
        f"# {HEAD}",
        "linear.x.max_acceleration: 0.5 # [m/s^2]; calibrated, 0.9 before",
        "command_latency: 0.229 # [s], from a pose's stamp to the motion that its command causes; "
        "calibrated, +- 0.014, 0.12 before",
        "drive_time_constant: 0.1 # [s]; calibrated, 0.05 before",
        "odometry_delay: 0.21 # calibrated, +- 0.01",
        "alpha1: 1.0e-05 # calibrated, +- 7 %, at its bound",
        "global_pose_sigma_xy: 0.0512 # [m], for a global_pose without covariance; calibrated, 0.03 before",
        "eps_xy_max: 0.08868 # [m], 1.73 times the standard deviation; calibrated, 0.051962 before",
    ]
    check_data_sheet(path)
    assert list(contradictions(read_robot(path))) == [], "the simulated robot is the calibrated one"
    controller = build(ControllerNodeConfig, values_of(values(path, "controller"), ControllerNodeConfig))
    assert controller.supervisor.controller.data_sheet.v_max == 0.31


def test_simulated_errors_stay_within_their_bounds(tmp_path):
    path = tmp_path / "calibrated.yaml"
    written(path, file_of_robot(PRESETS["turtlebot4"]), FOUND._replace(parameters={"global_pose_sigma_yaw": 2.0}))
    assert read_robot(path).plant.world.sensors.eps_theta_max == math.pi


def test_a_limit_of_acceleration_is_never_raised(tmp_path):
    path = tmp_path / "calibrated.yaml"
    written(path, file_of_robot(PRESETS["turtlebot4"]))
    assert values(path, "controller")["angular.z.max_acceleration"] == 7.7, "9.0 was measured"
    written(path, "/**/ekf: {ros__parameters: {}}\n")
    assert values(path, "controller")["angular.z.max_acceleration"] == 9.0, "none was given"


@pytest.mark.parametrize("name", FILES)
def test_all_other_values_and_comments_stay(tmp_path, name):
    path, text = tmp_path / "calibrated.yaml", FILES[name]
    path.write_text(text)
    before = {node: values(path, node) for node in ("ekf", "controller")}
    parameters = FOUND.parameters | {"pose_source_sigma_xy": [0.1, 0.2], "correlation_times": [2.0, 0.5, 0.0]}
    after = written(path, text, FOUND._replace(parameters=parameters))
    base = {"command_latency": 0.229, "drive_time_constant": 0.1}
    base |= {"linear.x.max_acceleration": 0.5, "angular.z.max_acceleration": 9.0}
    assert values(path, "controller") == before["controller"] | base
    found = before["ekf"] | parameters
    assert values(path, "ekf") == found | {name: base[name] for name in base if name in values(path, "ekf")}
    for comment in [line.partition("#")[2].strip() for line in text.splitlines() if "#" in line]:
        assert f"# {comment}" in after
    read_config(path)


@pytest.mark.parametrize(
    ("factor", "deviation", "note"),
    [(0.5, 0.5, ""), (0.5, 0.9, "not determined"), (0.01, 0.9, "only its order of magnitude is determined")],
)
def test_a_noise_of_the_motion_known_to_a_factor_of_two_only_is_kept_unless_the_given_value_is_excluded(
    factor, deviation, note, monkeypatch
):
    config = build(EkfNodeConfig, {})
    quantity = Quantity("alpha1", "alpha1", (), True, 0.0, -10.0, 10.0)
    fit = SimpleNamespace(values=np.log([factor]), covariance=np.array([[deviation**2]]), at_bound=[False])
    for name in ("_add_constants", "_measurement_noise"):
        monkeypatch.setattr(parameters, name, lambda *_: {})
    calibration = SimpleNamespace(found=fit, quantities=[quantity], biases=[], drives=[])
    result = parameters.result_of(calibration, config)
    given = to_dict(config)["alpha1"]
    is_kept = note == "not determined"
    assert result.parameters["alpha1"] == pytest.approx(given if is_kept else given * factor, rel=1e-3)
    assert [name for name, _ in result.undetermined] == ["alpha1"] * is_kept
    assert result.rows[0].note == note


def test_a_drive_without_commands_lists_latency_and_time_constant_as_not_determined():
    figures = HeldOutFigures(0.0, Consistency(1.0, 0.0, 0.1))
    text = describe(SimpleNamespace(before=figures, after=figures), CalibrationResult({}, [], []), None)
    _, kept = text.split("Not determined by the drives, kept as given:")
    assert [line.split(":")[0].strip() for line in kept.strip().splitlines()] == [
        "command_latency",
        "drive_time_constant",
    ]
    assert "record /cmd_vel" in kept
