"""Nav2's docking server as a law: its approach against Park and Kuipers' equations, its phases, and its end."""

import cmath
import math

import pytest
from driven import Robot, seen

from diffbot_core.geometry import Pose
from diffbot_lab.laws.nav2_docking import (
    APPROACHING,
    ENDED,
    PRESSING,
    STAGING,
    Nav2Docking,
    Nav2DockingConfig,
    approach,
    next_state,
)

DEFAULTS = Nav2DockingConfig()


def graceful(x, y, theta):
    """Park and Kuipers' Eq. (13) and (15) with the gains of the docking server, in complex numbers."""
    to_dock = -complex(x, y)
    r = abs(to_dock)
    delta = cmath.phase(cmath.exp(1j * theta) / (to_dock / r))
    phi = cmath.phase(1.0 / (to_dock / r))
    steer = 2.0 * (delta - math.atan(-3.0 * phi)) + (1.0 + 3.0 / (1.0 + 9.0 * phi * phi)) * math.sin(delta)
    curvature = -steer / r
    v = min(0.25 / (1.0 + 0.4 * curvature**2), 0.25 * r / 0.25)
    v = max(v, 0.1)
    omega = max(-0.75, min(0.75, curvature * v))
    return omega / curvature, omega


@pytest.mark.parametrize("pose", [(-0.7, 0.02, -0.1), (-0.15, 0.03, 0.2), (-0.9, 0.3, -0.4)])
def test_the_approach_is_the_graceful_law_with_the_gains_of_the_docking_server(pose):
    assert approach(Pose(*pose), DEFAULTS) == pytest.approx(graceful(*pose), abs=1e-12)


def driven(start, config, steps=400, dt=0.05):
    """Drive a unicycle by the law. Return poses, commands and phases."""
    robot, memory, found, dock = Robot(start), Nav2Docking.new_memory(config), [], Pose(0.0, 0.0, 0.0)
    for index in range(steps):
        observation = seen(robot.pose, dt=dt if index else 0.0, period=dt)
        memory, command, _ = Nav2Docking.step(memory, observation, dock, config)
        found.append((robot.pose, command, memory.state.phase))
        robot.drive(command, dt)
    return found


@pytest.mark.parametrize(
    ("start", "phases"),
    [
        (Pose(-2.0, 0.3, -0.2), [STAGING, APPROACHING, PRESSING, ENDED]),
        (Pose(-1.0, 0.39, 0.0), [APPROACHING, PRESSING, ENDED]),  # 0.49 m from the staging pose
        (Pose(-1.0, 0.41, 0.0), [STAGING, APPROACHING, PRESSING, ENDED]),
    ],
)
def test_the_robot_skips_staging_within_half_a_metre_and_presses_on_at_the_dock(start, phases):
    found = driven(start, DEFAULTS)
    assert list(dict.fromkeys(phase for *_, phase in found)) == phases
    at, _, _ = next(one for one in found if one[2] == APPROACHING)
    assert at[:2] == pytest.approx((-0.7, 0.0) if phases[0] == STAGING else start[:2], abs=0.1)
    assert all(command.v <= 0.25 and abs(command.omega) <= 0.75 for _, command, phase in found if phase == APPROACHING)
    pressed = [one for one in found if one[2] == PRESSING]
    assert math.hypot(*pressed[0][0][:2]) < 0.05
    assert {command for _, command, _ in pressed[1:]} == {(0.1, 0.0)}
    assert 0.03 <= found[-1][0].x < 0.05
    assert {command for _, command, _ in found[-20:]} == {(0.0, 0.0)}


def test_docking_backwards_is_the_same_drive_turned_by_pi():
    start = Pose(-2.0, 0.3, -0.2)
    forwards = driven(start, DEFAULTS)
    found = driven(Pose(-start.x, -start.y, start.theta), DEFAULTS._replace(dock_backward=True))
    straight = [one for one in zip(forwards, found, strict=True) if one[0][2] in (APPROACHING, PRESSING)]
    assert len(straight) > 50
    for (pose, command, _), (turned, mirrored, _) in straight:
        assert turned == pytest.approx((-pose.x, -pose.y, pose.theta), abs=1e-9)
        assert mirrored == pytest.approx((-command.v, command.omega), abs=1e-9)


def test_an_approach_of_more_than_thirty_seconds_is_retried_three_times():
    state, phases = Nav2Docking.new_memory(DEFAULTS).state, []
    for _ in range(1500):
        state = next_state(state, Pose(-0.3, 0.0, 0.0), 0.1, DEFAULTS)
        if state.phase == STAGING:
            state = state._replace(drive=state.drive._replace(reached=True))
        phases.append(state.phase)
    assert phases.count(STAGING) == 3
    assert phases.index(STAGING) in (300, 301)
    assert phases[-1] == ENDED
    assert phases.index(ENDED) == pytest.approx(4 * 301, abs=5)
