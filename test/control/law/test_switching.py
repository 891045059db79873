"""The law ``switching`` in whole drives: dead time and lag, regions, limits, either heading, departures, memory."""

import math

import pytest
from driven import ORIGIN, Run, seen

from diffbot_control.law.goal_checker import Settling
from diffbot_control.law.latency import Actuation, resting_actuation
from diffbot_control.law.regions import MAX_DEPARTURES, OMEGA_G, OMEGA_L, Switching
from diffbot_control.law.registry import PRESETS
from diffbot_control.law.steering import BACKWARD, Approach
from diffbot_control.law.switching import SwitchingLaw, SwitchingMemory, new_memory, step
from diffbot_core.geometry import Pose
from diffbot_core.kinematics import Twist
from diffbot_core.schema import build, to_dict
from diffbot_core.uncertainty import Uncertainty

TUNED = PRESETS["tuned"].config
FORWARD = TUNED._replace(allow_backward=False)


@pytest.mark.parametrize(
    ("latency", "lag", "limits", "start", "period"),
    [
        (0.0, 0.0, {}, (-4.0, 3.0, 2.0), 0.1),
        (0.3, 0.0, {}, (2.0, -5.0, -1.0), 0.1),
        (0.0, 0.3, {}, (0.5, 0.6, 3.0), 0.1),
        (0.1, 0.1, {"a_max": 0.5, "omega_dot_max": 1.5}, (3.0, 0.2, 0.1), 0.1),
        (0.25, 0.15, {"a_max": 0.5, "omega_dot_max": 1.5, "omega_max": 1.5}, (-0.3, 0.4, -2.0), 0.1),
        (0.25, 0.15, {"a_max": 0.5, "omega_dot_max": 1.5, "omega_max": 1.5}, (-8.0, 0.0, 0.0), 0.1),
        (0.0, 0.0, {}, (-2.0, 1.5, 2.5), 0.02),
        (0.3, 0.0, {}, (-2.0, 1.5, 2.5), 0.4),
    ],
)
def test_a_robot_whose_data_sheet_is_known_arrives_without_spinning(latency, lag, limits, start, period):
    sheet = TUNED.data_sheet._replace(command_latency=latency, drive_time_constant=lag, **limits)
    run = Run(start, TUNED._replace(data_sheet=sheet), round(40.0 / period), period=period)
    assert run.memory.reached
    assert math.hypot(run.robot.pose.x, run.robot.pose.y) < 0.03
    assert abs(run.robot.pose.theta) < 0.01
    assert run.robot.turned < 1.5 * math.tau
    assert run.settled_after < 2.0 * math.hypot(start[0], start[1]) + 12.0


@pytest.mark.parametrize("angle", [1.5, 3.1, -3.0])
@pytest.mark.parametrize(("latency", "omega_dot"), [(0.3, math.inf), (0.0, 1.5), (0.3, 0.5)])
def test_a_turn_on_the_spot_does_not_overshoot(angle, latency, omega_dot):
    sheet = TUNED.data_sheet._replace(command_latency=latency, omega_dot_max=omega_dot)
    run = Run((0.0, 0.0, angle), TUNED._replace(data_sheet=sheet), 200)
    headings = [pose.theta * math.copysign(1.0, angle) for pose in run.poses]
    assert min(headings) > -0.02
    assert abs(headings[-1]) < 1e-3


def test_a_goal_behind_with_the_same_heading_is_reached_backwards_and_only_if_allowed():
    run = Run((3.0, 0.0, 0.0), TUNED)
    assert run.commands[0].v < 0.0
    assert run.robot.turned < 0.05
    run = Run((3.0, 0.3, 0.0), FORWARD, 500)
    assert all(command.v >= 0.0 for command in run.commands)
    assert run.memory.reached


@pytest.mark.parametrize("start", [(-3.0, 0.0, math.pi), (2.0, 0.5, -2.9), (-0.02, 0.0, 2.0)])
def test_with_symmetric_yaw_tolerance_the_robot_arrives_with_the_nearer_heading(start):
    either = TUNED._replace(symmetric_yaw_tolerance=True)
    run, usual = Run(start, either), Run(start, TUNED)
    assert run.memory.reached
    assert abs(abs(run.robot.pose.theta) - math.pi) < 0.01
    assert abs(usual.robot.pose.theta) < 0.01
    assert run.robot.turned < usual.robot.turned - 0.7
    assert abs(run.reports[-1].theta) < 0.01


def test_a_pose_that_arrives_early_or_late_gets_the_same_command():
    for memory in (new_memory(), new_memory()._replace(switching=Switching(OMEGA_L, 1, 0.0))):
        commands = {step(memory, seen(Pose(-0.7, 0.2, 0.3), dt=dt), ORIGIN, TUNED)[1] for dt in (0.02, 0.1, 0.2, 1.0)}
        assert len(commands) == 1


def test_commands_are_outside_the_dead_bands():
    least = 0.1
    sheet = TUNED.data_sheet._replace(min_velocity=least, min_rotation=2.0 * least)
    for start in ((-4.0, 3.0, 2.0), (0.5, 0.6, 3.0), (3.0, 0.2, 0.1)):
        run = Run(start, TUNED._replace(data_sheet=sheet), 250)
        for command in run.commands:
            assert command.v == 0.0 or abs(command.v) >= least * (1.0 - 1e-12)
            # Where the bound of the rims lets the steering keep its rate.
            assert abs(command.omega) < 1e-12 or abs(command.omega) >= 2.0 * least * (1.0 - 1e-12) or command.v
        assert math.hypot(run.robot.pose.x, run.robot.pose.y) < 0.1


@pytest.mark.parametrize("config", [TUNED, FORWARD])
def test_a_significant_lateral_error_at_rest_leads_to_another_approach(config):
    rests = new_memory()._replace(switching=Switching(OMEGA_L, 1, 0.0))
    run = Run((0.0, 0.09, 0.0), config, 300, memory=rests, uncertainty=Uncertainty(0.01, 0.01))
    regions = [report.region for report in run.reports]
    # One second at rest, then one departure from Omega_L.
    assert regions.index(OMEGA_G) in (10, 11)
    assert run.memory.switching == (OMEGA_L, 3, pytest.approx(run.memory.switching.rest))
    assert run.memory.reached
    assert math.hypot(run.robot.pose.x, run.robot.pose.y) < 0.03


def test_an_estimate_that_keeps_changing_ends_the_goal_after_the_largest_number_of_departures():
    memory, poses = new_memory(), (Pose(0.0, 0.0, 0.0), Pose(0.0, 0.5, 0.0))
    for number in range(2 * MAX_DEPARTURES):
        assert not SwitchingLaw.reason_to_give_up(memory, TUNED)
        memory, _, _ = step(memory, seen(poses[number % 2], Uncertainty(0.01, 0.01)), ORIGIN, TUNED)
    assert SwitchingLaw.reason_to_give_up(memory, TUNED).startswith(
        f"the robot left the neighbourhood of the goal {MAX_DEPARTURES} times"
    )


def test_a_new_goal_keeps_only_the_motion():
    motion = Twist(0.7, -0.3), Actuation(Twist(0.5, -0.2), resting_actuation().history)
    memory = SwitchingMemory(
        Switching(OMEGA_L, 4, 0.3), motion[0], Settling(9, True), Approach(BACKWARD, True), motion[1], True
    )
    expected = new_memory()._replace(command=motion[0], actuation=motion[1])
    assert SwitchingLaw.memory_for_new_goal(memory, TUNED) == expected


def test_commands_of_the_supervisor_count_in_the_prediction():
    config = TUNED._replace(data_sheet=TUNED.data_sheet._replace(command_latency=0.3))
    memory = new_memory()
    for command in (Twist(0.5, 0.1), Twist(0.2, 0.0), Twist(0.0, 0.0)):
        memory = SwitchingLaw.after_command(memory, command, 0.1, config)
    assert memory.command == (0.0, 0.0)
    assert [held[:2] for held in memory.actuation.history[-2:]] == [(0.5, 0.1), (0.2, 0.0)]
    # It replaces the command of the step: no time has passed.
    assert SwitchingLaw.after_command(memory, Twist(0.1, 0.0), 0.0, config).actuation == memory.actuation


def test_a_pose_that_is_not_finite_stops_the_robot():
    memory = new_memory()._replace(switching=Switching(OMEGA_L, 1, 0.0), command=Twist(0.5, 0.1))
    after, command, _ = step(memory, seen(Pose(math.nan, 0.0, 0.0)), ORIGIN, TUNED)
    assert command == after.command == (0.0, 0.0)
    assert not after.reached


@pytest.mark.parametrize("preset", PRESETS.values())
def test_every_preset_is_valid_and_survives_conversion_to_parameters(preset):
    assert build(preset.law.Config, to_dict(preset.config)) == preset.config
