"""The peers: they reach the goal, keep the limits, and compile to the same steps."""

import math

import numpy as np
import pytest
from driven import Robot, seen
from hypothesis import given, settings
from hypothesis import strategies as st

from diffbot_control.goals import Supervisor, SupervisorConfig
from diffbot_control.law.registry import registered_laws, resolve_law
from diffbot_core.data_sheet import DataSheet
from diffbot_core.geometry import Pose
from diffbot_core.kinematics import Twist
from diffbot_sim.jit import compile_kernel, law_version

ORIGIN = Pose(0.0, 0.0, 0.0)
LAWS = [name for name in registered_laws() if name not in ("switching", "paper")]
SHEET = DataSheet(1.3, 2.6, 26.0, 0.5, 1.5)


def with_sheet(law, sheet):
    """Return the default configuration with a data sheet; a docking law has it in the configuration of its drive."""
    config = law.Config()
    if "drive" in config._fields:
        return config._replace(drive=config.drive._replace(data_sheet=sheet))
    return config._replace(data_sheet=sheet)


def drive(law, config, pose, seconds, t_s=0.1, latency=0.0, *, until_reached=False):
    """Drive an ideal robot with a dead time. Return the final pose, the commands and the last memory."""
    memory, commands, robot = law.new_memory(config), [], Robot(pose, latency)
    for index in range(round(seconds / t_s)):
        observation = seen(robot.pose, dt=t_s if index else 0.0, period=t_s)
        memory, command, _ = law.step(memory, observation, ORIGIN, config)
        if until_reached and memory.reached:
            break
        robot.drive(command, t_s)
        commands.append(command)
    return robot.pose, commands, memory


@pytest.mark.parametrize("name", LAWS)
@pytest.mark.parametrize("start", [(-3.0, 1.0, 0.5), (2.0, -1.0, -2.5)])
def test_a_law_drives_to_the_pose_and_reports_reached(name, start):
    law = resolve_law(name)
    pose, commands, memory = drive(law, law.Config(), Pose(*start), 60.0)
    assert math.hypot(pose.x, pose.y) < 0.1
    assert abs(pose.theta) < 0.1
    assert memory.reached
    assert commands[-1] == (
        Twist(0.0, 0.0) if name != "feedback_linearisation" else pytest.approx((0.0, 0.0), abs=1e-2)
    )


@pytest.mark.parametrize("name", LAWS)
def test_reached_is_not_reported_while_the_robot_coasts(name):
    """With a dead time the coasted pose reaches the goal before the robot."""
    law = resolve_law(name)
    config = with_sheet(law, SHEET._replace(command_latency=0.5))
    pose, _, memory = drive(law, config, Pose(-3.0, 0.1, 0.0), 60.0, latency=0.5, until_reached=True)
    assert memory.reached
    assert math.hypot(pose.x, pose.y) < 0.1


def test_a_robot_that_passes_a_waypoint_does_not_brake():
    law = resolve_law("pure_pursuit")
    supervisor, x, speeds = Supervisor(SupervisorConfig(with_sheet(law, SHEET), waypoint_radius=4.0), law), -5.0, []
    supervisor.on_path([ORIGIN, Pose(9.0, 0.0, 0.0)])
    for number in range(70):
        command = supervisor.on_pose(10**8 * number, 0.1 * number, Pose(x, 0.0, 0.0))
        x += 0.1 * command.v
        speeds.append(command.v)
    assert supervisor.waypoint == 2
    assert speeds == sorted(speeds)
    # The law also gets the command that stops the robot without a pose.
    assert supervisor.on_tick(100.0) == supervisor.memory.command == (0.0, 0.0)


poses = st.builds(Pose, *(st.floats(-5.0, 5.0),) * 2, st.floats(-3.1, 3.1))


@settings(max_examples=75)
@given(st.sampled_from(LAWS), st.lists(poses, min_size=2, max_size=6), st.floats(0.2, 2.0), st.floats(0.3, 3.0))
def test_all_commands_keep_the_limits_whatever_the_estimates(name, jumps, a_max, omega_dot_max):
    law = resolve_law(name)
    sheet = SHEET._replace(a_max=a_max, omega_dot_max=omega_dot_max, command_latency=0.2, drive_time_constant=0.1)
    config = with_sheet(law, sheet)
    memory, last = law.new_memory(config), Twist(0.0, 0.0)
    for index, pose in enumerate(jumps * 3):
        dt = 0.1 if index else 0.0
        memory, command, _ = law.step(memory, seen(pose, dt=dt), ORIGIN, config)
        assert abs(command.v) <= 1.3 + 1e-9
        assert abs(command.omega) <= 2.6 + 1e-9
        assert abs(command.v) + 0.3 * abs(command.omega) <= 1.3 + 1e-9
        assert abs(command.v - last.v) <= a_max * dt + 1e-9
        assert abs(command.omega - last.omega) <= omega_dot_max * dt + 1e-9
        last = command


def numbers_of(value):
    """Return the numbers of nested tuples in order."""
    return [one for part in value for one in numbers_of(part)] if isinstance(value, tuple) else [float(value)]


@pytest.mark.study
@pytest.mark.parametrize("name", ["pure_pursuit", "nav2_docking"])
def test_a_law_compiles_to_the_same_steps(name):
    law = resolve_law(name)
    step, version = law.step, law_version(law)

    def one_step(memory, observation, goal, config):
        return step(memory, observation, goal, config)

    compiled = compile_kernel(one_step, version)
    config = with_sheet(law, SHEET._replace(command_latency=0.2))
    memory = law.new_memory(config)
    for index, x in enumerate(np.linspace(-3.0, 0.0, 40).tolist()):
        pose = Pose(x, 0.5 * math.sin(x), 0.3 * x)
        given = memory, seen(pose, dt=0.1 if index else 0.0), ORIGIN, config
        found, plain = compiled(*given), law.step(*given)
        assert numbers_of(found) == pytest.approx(numbers_of(plain), abs=1e-12, nan_ok=True)
        memory = plain[0]
