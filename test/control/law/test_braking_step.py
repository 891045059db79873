"""One step of the law with braking profiles, in whole drives: dead time and lag, regions, limits, either heading."""

import math

import pytest
from driven import ORIGIN, T_S, Run

from diffbot_control.law import controller
from diffbot_control.law.configuration import AUTO
from diffbot_control.law.controller import new_memory
from diffbot_control.law.presets import PRESETS
from diffbot_core.geometry import Pose
from diffbot_core.uncertainty import Estimate, Uncertainty

TUNED = PRESETS["tuned"]
FORWARD = TUNED._replace(driving=TUNED.driving._replace(allow_backward=False))


@pytest.mark.parametrize(
    ("latency", "lag", "limits", "start"),
    [
        (0.0, 0.0, {}, (-4.0, 3.0, 2.0)),
        (0.3, 0.0, {}, (2.0, -5.0, -1.0)),
        (0.0, 0.3, {}, (0.5, 0.6, 3.0)),
        (0.1, 0.1, {"a_max": 0.5, "omega_dot_max": 1.5}, (3.0, 0.2, 0.1)),
        (0.25, 0.15, {"a_max": 0.5, "omega_dot_max": 1.5, "omega_max": 1.5}, (-0.3, 0.4, -2.0)),
        (0.25, 0.15, {"a_max": 0.5, "omega_dot_max": 1.5, "omega_max": 1.5}, (-8.0, 0.0, 0.0)),
    ],
)
def test_a_robot_whose_data_sheet_is_known_arrives_without_spinning(latency, lag, limits, start):
    sheet = TUNED.data_sheet._replace(command_latency=latency, drive_time_constant=lag, **limits)
    run = Run(start, TUNED._replace(data_sheet=sheet), 400, latency, lag)
    assert run.memories[-1].reached
    assert math.hypot(run.end.x, run.end.y) < 0.03
    assert abs(run.end.theta) < 0.01
    assert run.robot.turned < 1.5 * math.tau
    assert run.settled_after < 2.0 * math.hypot(start[0], start[1]) + 12.0


@pytest.mark.parametrize("angle", [1.5, 3.1, -3.0])
@pytest.mark.parametrize(("latency", "omega_dot"), [(0.3, math.inf), (0.0, 1.5), (0.3, 0.5)])
def test_a_turn_on_the_spot_does_not_overshoot(angle, latency, omega_dot):
    sheet = TUNED.data_sheet._replace(command_latency=latency, omega_dot_max=omega_dot)
    run = Run((0.0, 0.0, angle), TUNED._replace(data_sheet=sheet), 200, latency)
    headings = [pose.theta * math.copysign(1.0, angle) for pose in run.poses]
    assert min(headings) > -0.02
    assert abs(headings[-1]) < 1e-3


def test_a_goal_behind_with_the_same_heading_is_reached_backwards_and_only_if_allowed():
    run = Run((3.0, 0.0, 0.0), TUNED)
    assert run.commands[0].v < 0.0
    assert run.robot.turned < 0.05
    run = Run((3.0, 0.3, 0.0), FORWARD, 500)
    assert all(command.v >= 0.0 for command in run.commands)
    assert run.memories[-1].reached


@pytest.mark.parametrize("start", [(-3.0, 0.0, math.pi), (2.0, 0.5, -2.9), (-0.02, 0.0, 2.0)])
def test_either_heading_will_do_with_symmetric_yaw_tolerance(start):
    either = TUNED._replace(driving=TUNED.driving._replace(symmetric_yaw_tolerance=True))
    run, usual = Run(start, either), Run(start, TUNED)
    assert run.memories[-1].reached
    assert abs(abs(run.end.theta) - math.pi) < 0.01
    assert abs(usual.end.theta) < 0.01
    assert run.robot.turned < usual.robot.turned - 0.7
    assert abs(run.reports[-1].theta) < 0.01


def test_the_uncertainty_that_counts_is_a_multiple_of_the_filters():
    scaled = TUNED._replace(uncertainty_scale=2.5)
    memory = other = new_memory()
    for number in range(60):
        pose = Pose(-2.0 + 0.04 * number, 0.3, 0.1)
        memory, command, report = controller.step(memory, Estimate(pose, Uncertainty(0.02, 0.01)), ORIGIN, T_S, scaled)
        other, expected, same = controller.step(other, Estimate(pose, Uncertainty(0.05, 0.025)), ORIGIN, T_S, TUNED)
        assert (memory, command, report) == (other, expected, same)


@pytest.mark.parametrize(("period", "latency"), [(0.02, 0.0), (0.1, 0.3), (0.4, 0.3)])
def test_automatic_gains_arrive_at_any_period(period, latency):
    sheet = TUNED.data_sheet._replace(command_latency=latency)
    config = TUNED._replace(gain_source=AUTO, data_sheet=sheet)
    run = Run((-2.0, 1.5, 2.5), config, round(25.0 / period), latency, period=period)
    assert run.memories[-1].reached
    assert math.hypot(run.end.x, run.end.y) < 0.03
    assert run.robot.turned < 1.5 * math.tau


def test_commands_are_outside_the_dead_bands():
    least = 0.1
    sheet = TUNED.data_sheet._replace(min_velocity=least, min_rotation=2.0 * least)
    for start in ((-4.0, 3.0, 2.0), (0.5, 0.6, 3.0), (3.0, 0.2, 0.1)):
        run = Run(start, TUNED._replace(data_sheet=sheet), 250)
        for command in run.commands:
            assert command.v == 0.0 or abs(command.v) >= least * (1.0 - 1e-12)
            # Where the bound of the rims lets the steering keep its rate.
            assert abs(command.omega) < 1e-12 or abs(command.omega) >= 2.0 * least * (1.0 - 1e-12) or command.v
        assert math.hypot(run.end.x, run.end.y) < 0.1
