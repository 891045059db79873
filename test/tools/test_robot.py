"""A robot of the user: the parameter file, its faults, and simulated drives."""

import math
import re
from pathlib import Path

import numpy as np
import pytest
import yaml

from diffbot_control.filter.odometry import OdometryConfig
from diffbot_core.geometry import Pose
from diffbot_sim.config import StartPose
from diffbot_sim.simulation import ClosedLoop, simulate
from diffbot_tools import cli
from diffbot_tools import robot_trial as check
from diffbot_tools.robot import read_robot
from diffbot_tools.robot_description import PRESETS, RobotDescription, file_of_robot
from diffbot_tools.robot_trial import FAR, SHORT, median_share, trials

EXAMPLES = Path(__file__).parents[2] / "examples"
TANK = RobotDescription(
    wheel_radius=0.3, wheel_separation=1.6, linear_x_max_velocity=3.0, angular_z_max_velocity=0.8,
    linear_x_max_acceleration=0.4, angular_z_max_acceleration=0.4,
    command_latency=0.4, drive_time_constant=0.4, odometry_rate=10.0, slip=0.05,
    fix_rate=1.0, fix_delay=0.4, global_pose_sigma_xy=0.1, xy_goal_tolerance=0.3,
)  # fmt: skip
MOUSE = RobotDescription(
    wheel_radius=0.012, wheel_separation=0.07, linear_x_max_velocity=0.8, angular_z_max_velocity=10.0,
    linear_x_max_acceleration=4.0, angular_z_max_acceleration=60.0,
    command_latency=0.03, drive_time_constant=0.02, odometry_rate=50.0,
    fix_rate=25.0, fix_delay=0.03, global_pose_sigma_xy=0.002, global_pose_sigma_yaw=0.02, xy_goal_tolerance=0.02,
)  # fmt: skip
"""Two robots unlike the presets: a heavy robot with a long latency, and a micromouse."""
WITHOUT_HEADING = RobotDescription(global_pose_sigma_yaw=2.0, fix_rate=20.0, pose_correlation=100.0)
"""The simulated errors are at their bounds."""


def written(path, description=None, **values):
    """Write the file of a robot with some parameters changed, by section and name; None removes one."""
    content = yaml.safe_load(file_of_robot(description or RobotDescription(), path.name))
    for name, value in values.items():
        section, _, key = name.partition("__")
        parameters = content["/**" if section == "all" else f"/**/{section}"]["ros__parameters"]
        parameters[key.replace("__", ".")] = value
        if value is None:
            del parameters[key.replace("__", ".")]
    path.write_text(yaml.safe_dump(content))
    return path


@pytest.mark.parametrize("description", [*PRESETS.values(), TANK, MOUSE, WITHOUT_HEADING])
def test_a_file_describes_the_same_robot_as_its_description_and_has_no_faults(description, tmp_path):
    path = tmp_path / "robot.yaml"
    path.write_text(file_of_robot(description, path.name))
    robot, direct = read_robot(path), read_robot(description)
    assert robot[1:] == direct[1:]
    # The file rounds to six digits.
    assert robot.plant.world.sensors.eps_xy_max == pytest.approx(
        math.sqrt(3.0) * description.global_pose_sigma_xy, abs=1e-6
    )
    sheet, plant = robot.controller.supervisor.controller.data_sheet, robot.plant.world.plant
    assert (sheet.v_max, sheet.a_max) == (description.linear_x_max_velocity, description.linear_x_max_acceleration)
    assert plant.acceleration_max == sheet.a_max
    assert plant.angular_acceleration_max == sheet.omega_dot_max == description.angular_z_max_acceleration
    assert plant.command_delay == sheet.command_latency == description.command_latency
    assert robot.plant.world.plant.wheels == sheet.wheels == robot.ekf.wheels
    assert [*check.missing(robot), *check.contradictions(robot)] == []


@pytest.mark.parametrize(
    ("changes", "kind", "text"),
    [
        ({"all__linear__x__max_acceleration": None}, check.missing, "linear.x.max_acceleration"),
        ({"ekf__global_pose_sigma_xy": None}, check.missing, "global_pose without covariance is dropped"),
        ({"ekf__wheel_separation": 0.3}, check.contradictions, "controller 0.16, plant 0.16, ekf 0.3"),
        ({"all__wheel__max_velocity": 2.0}, check.contradictions, "allows only 0.066"),
        (
            {"controller__pose_timeout": 0.06},
            check.contradictions,
            "two periods of odom = 0.1: pose_timeout is only 0.06",
        ),
    ],
)
def test_missing_and_contradictory_values_are_found(changes, kind, text, tmp_path):
    robot = read_robot(written(tmp_path / "robot.yaml", **changes))
    (found,) = [(one, text in said) for one in (check.missing, check.contradictions) for said in one(robot)]
    assert found == (kind, True)


def test_the_check_of_a_robot_without_a_pose_names_the_reason(tmp_path, kept_signal_handlers, capsys):
    assert cli.main(["robot", "check", str(written(tmp_path / "robot.yaml", plant__fix_rate=0.0))]) == 1
    assert capsys.readouterr().out.endswith(
        "not reached: the filter has no pose, since the plant sends no fixes: set fix_rate\n"
    )


@pytest.mark.study
def test_the_check_of_a_robot_that_reaches_no_goal_proposes_a_sufficient_tolerance(
    tmp_path, kept_signal_handlers, capsys
):
    path = written(tmp_path / "robot.yaml", PRESETS["turtlebot4"], controller__xy_goal_tolerance=0.03)
    assert cli.main(["robot", "check", str(path)]) == 1
    out = capsys.readouterr().out
    assert out.count("not reached after") == len(check.GOALS)
    (proposed,) = re.findall(r"^not reached: set xy_goal_tolerance: (\S+)$", out, re.MULTILINE)
    assert 0.03 < float(proposed) < 0.1
    written(path, PRESETS["turtlebot4"], controller__xy_goal_tolerance=float(proposed))
    assert cli.main(["robot", "check", str(path)]) == 0


def test_a_drive_equals_the_reference_loop():
    """Plant, filter and law agree in each step until the goal is reached."""
    robot = read_robot(PRESETS["turtlebot4"]._replace(fix_delay=0.0))
    goal, start = Pose(1.5, 0.5, 0.0), StartPose(1.0, 0.0, 0.5)
    world, localization, supervisor, rest = robot.parts(3, start)
    # The reference loop uses the covariances in the odometry messages.
    localization = localization._replace(odometry=OdometryConfig())
    drive = ClosedLoop(world, localization, supervisor, rest).drive(goal)
    steps = len(drive.time) - 1
    loop = simulate(world, supervisor.controller, goal, steps, localization=localization)
    for mine, other in zip(drive[3:7], loop[:4], strict=True):
        assert np.nan_to_num(mine) == pytest.approx(np.nan_to_num(other), abs=1e-12)
    assert loop.reached.tolist() == [False] * steps + [True]
    assert drive.duration == pytest.approx(0.05 * steps)


@pytest.mark.study
@pytest.mark.parametrize("given", [*PRESETS, TANK, MOUSE], ids=[*PRESETS, "tank", "mouse"])
def test_every_goal_is_truly_reached(given):
    robot = read_robot(given)
    found, tolerance = list(trials(robot, 12, seed=2)), robot.controller.supervisor.controller.tolerance
    assert [kind for kind, _ in found] == [FAR, SHORT] * 6
    assert [drive.reason for _, drive in found if not drive.is_reached] == []
    for kind in (FAR, SHORT) if given in PRESETS else ():
        assert median_share(robot, [drive for other, drive in found if other == kind]) < 1.5
    for _, drive in found:
        x, y, theta = drive.truth[-1] - np.array(drive.goal)
        assert math.hypot(x, y) < tolerance.xy_goal_tolerance
        assert abs(math.remainder(theta, math.tau)) < tolerance.yaw_goal_tolerance


def test_the_commands_write_check_and_drive(tmp_path, kept_signal_handlers, capsys):
    path, picture = tmp_path / "new" / "mine.yaml", tmp_path / "drives.png"
    words = ["robot", "new", str(path), "--like", "warehouse_agv", "--linear-x-max-velocity", "0.8"]
    assert cli.main(words) == 0
    assert f"diffbot robot check {path}" in capsys.readouterr().out
    assert read_robot(path)[1:] == read_robot(PRESETS["warehouse_agv"]._replace(linear_x_max_velocity=0.8))[1:]
    assert cli.main(words) == 1
    assert "already exists" in capsys.readouterr().err
    assert cli.main(["robot", "check", str(path)]) == 0
    assert capsys.readouterr().out.count("reached after") == len(check.GOALS)
    for _ in range(2):  # the second drive replaces the picture
        assert cli.main(["robot", "drive", str(path), "--goals", "2", "--out", str(picture)]) == 0
        assert capsys.readouterr().out.count("1 of 1") == 2
    assert picture.read_bytes().startswith(b"\x89PNG")


def test_robot_new_asks_for_missing_values_and_again_after_a_bad_answer(
    tmp_path, kept_signal_handlers, monkeypatch, capsys
):
    asked, answers = [], ["?", "0.05", "a foot", "-1", "0.3", *[""] * 6, "?", "maybe", "Y", *[""] * 30]
    monkeypatch.setattr("sys.stdin.isatty", lambda: True, raising=False)
    monkeypatch.setattr("builtins.input", lambda text: asked.append(text) or answers.pop(0))
    path = tmp_path / "mine.yaml"
    assert cli.main(["robot", "new", str(path), "--linear-x-max-velocity", "0.4"]) == 0
    expected = RobotDescription(wheel_radius=0.05, wheel_separation=0.3, use_gyro=True, linear_x_max_velocity=0.4)
    assert path.read_text() == file_of_robot(expected, "mine.yaml")
    assert asked[:2] == ["wheel radius [m] (0.033): "] * 2
    assert sum(text.startswith("distance between the middles") for text in asked) == 3
    assert not any("largest speed" in text for text in asked)
    assert asked.count("a gyro on the topic imu (n): ") == 3
    out = capsys.readouterr().out
    assert "wheel_radius: wheel radius in m, >= 0.001 and <= 10; Return keeps 0.033" in out
    assert "use_gyro: y if the robot has a gyro on the topic imu, n if not; Return answers n" in out
    assert "must be >= 0.001" in out
    assert "use_gyro = 'maybe': must be y or n" in out


def test_a_law_of_the_user_has_the_tolerances_of_the_file(tmp_path, kept_signal_handlers, monkeypatch, capsys):
    """The law of docs/how-to/own-law.md."""
    monkeypatch.syspath_prepend(EXAMPLES)
    path = written(tmp_path / "robot.yaml", PRESETS["turtlebot4"], controller__law="straight_line:StraightLine")
    assert cli.main(["robot", "drive", str(path), "--goals", "2", "--out", str(tmp_path / "drives.png")]) == 0
    out = capsys.readouterr().out
    assert out.count("1 of 1") == 2
    assert "not within 0.15 m and 0.15 rad" in out


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (["new", "{}/a.yaml"], "its input is not a terminal"),
        (["check", "turtlebot"], "did you mean turtlebot"),
        (["drive", "turtlebot4", "--goals", "1", "--out", "{}/a.foo"], "'foo' is not supported"),
    ],
)
def test_an_error_is_one_line(words, text, tmp_path, kept_signal_handlers, monkeypatch, capsys):
    monkeypatch.setattr("sys.stdin.isatty", lambda: False, raising=False)
    assert cli.main(["robot", *(word.format(tmp_path) for word in words)]) == 1
    error = capsys.readouterr().err
    assert text in error
    assert error.count("\n") == 1
