"""Docking: the motion on the axis compared with integrated kinematics, phases of whole runs, limits, mirror images."""

import math
import random
from dataclasses import dataclass, field

import numpy as np
import pytest
from driven import Robot
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from diffbot_control.law import docking
from diffbot_control.law.configuration import DockingConfig, SwitchingConfig
from diffbot_control.law.docking import (
    APPROACHING,
    DOCKED,
    FAILED,
    RETREATING,
    STAGING,
    UNDOCKED,
    UNDOCKING,
    Docking,
    docking_step,
    new_docking_memory,
)
from diffbot_control.law.law import CONTACT, CONTACT_UNKNOWN, NO_CONTACT, Observation
from diffbot_core.data_sheet import DataSheet
from diffbot_core.geometry import Pose
from diffbot_core.kinematics import Twist
from diffbot_core.uncertainty import CERTAIN, Estimate, Uncertainty

SHEET = DataSheet(0.5, 1.5, 9.0, 0.5, 2.0)
CONFIG = DockingConfig(drive=SwitchingConfig(data_sheet=SHEET))
ORIGIN, OUT = Pose(0.0, 0.0, 0.0), Pose(-0.7, 0.0, 0.0)
STARTS = [
    Pose(-2.0, 0.5, 0.3),
    Pose(-1.0, -1.0, 2.0),
    Pose(0.5, 1.0, 0.0),
    Pose(-0.3, 0.1, 0.2),
    Pose(-0.69, 0.01, -0.3),
]
VAGUE = Uncertainty(0.02, 0.001)
DT = 0.05


@dataclass
class Run:
    """A robot that docks; ``seen`` returns its estimate of a pose, and ``wall`` is the x at which the dock stops it."""

    config: DockingConfig = CONFIG
    goal: Pose = ORIGIN
    seen: object = Estimate
    wall: float = math.inf
    contact: int = CONTACT_UNKNOWN
    memory: docking.DockingMemory | None = None
    commands: list = field(default_factory=list)
    phases: list = field(default_factory=list)
    poses: list = field(default_factory=list)

    @property
    def pose(self):
        return self.poses[-1]

    def drive(self, start, duration=60.0, until=(DOCKED, FAILED, UNDOCKED)):
        sheet = self.config.drive.data_sheet
        robot = Robot(start, sheet.command_latency, sheet.drive_time_constant)
        self.memory = self.memory or new_docking_memory(self.config)
        for index in range(round(duration / DT)):
            observation = Observation(self.seen(robot.pose), DT if index else 0.0, DT, self.contact)
            self.memory, command, report = docking_step(self.memory, observation, self.goal, self.config)
            assert np.isfinite(report).all()
            self.commands.append(command)
            self.poses.append(robot.pose)
            if self.phases[-1:] != [self.memory.stage.phase]:
                self.phases.append(self.memory.stage.phase)
            if self.memory.stage.phase in until:
                return self
            robot.drive(command, DT)
            robot.pose = robot.pose._replace(x=min(robot.pose.x, self.wall))
        pytest.fail(f"still {docking.PHASE_NAMES[self.memory.stage.phase]} at {robot.pose}")


@pytest.mark.parametrize(("v", "x"), [(0.1, -0.8), (0.03, -0.5), (0.1, -0.2), (0.1, -0.03)])
def test_the_error_at_contact_is_predicted_at_any_speed(v, x):
    start = Pose(x, 2e-4, -3e-3)

    def rates(_, state):
        pose, distance = Pose(*state), -state[0]
        if distance > CONFIG.commit_distance:
            command = docking.along_axis(pose, v, docking.APPROACH_LENGTH)
        elif distance > docking.STRAIGHT_LENGTH:
            command = docking.hold_heading(pose, v, docking.APPROACH_LENGTH)
        else:
            command = Twist(v, 0.0)
        return command.v * math.cos(pose.theta), command.v * math.sin(pose.theta), command.omega

    def contact(_, state):
        return state[0]

    contact.terminal = True
    found = solve_ivp(rates, (0.0, 2.0 * abs(x) / v), start, events=contact, max_step=2e-3 / v, rtol=1e-9, atol=1e-12)
    assert docking.contact_error(start, CONFIG) == pytest.approx(found.y[1:, -1], rel=5e-3, abs=2e-7)
    assert found.y[0, -1] == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("v", [0.3, -0.3])
def test_on_the_axis_the_lyapunov_function_decreases_as_stated_in_both_directions(v):
    rng, h = random.Random(1), 1e-6
    for _ in range(300):
        length = rng.uniform(0.05, 1.0)
        pose = Pose(rng.uniform(-2.0, 0.0), rng.uniform(-1.0, 1.0), rng.uniform(-3.0, 3.0))
        command = docking.along_axis(pose, v, length)
        ends = Robot(pose), Robot(pose)
        for robot, dt in zip(ends, (-h, h), strict=True):
            robot.drive(command, dt)
        before, after = (docking.axis_lyapunov(robot.pose, length) for robot in ends)
        slope = (after - before) / (2.0 * h)
        assert slope == pytest.approx(-2.0 * abs(v) * pose.theta**2 / length, rel=1e-4, abs=1e-4)
        assert command.v == v
    assert docking.along_axis(Pose(-1.0, 0.3, 0.4), 0.0, 0.1) == (0.0, 0.0)


@pytest.mark.parametrize("start", STARTS)
def test_it_docks_straight_and_its_mirror_image_gives_the_same_commands(start):
    run = Run().drive(start)
    assert run.memory.reached
    assert run.memory.stage.tries == 0
    assert run.phases[-2:] == [APPROACHING, DOCKED]
    assert abs(run.pose.y) < 2e-3
    assert abs(run.pose.theta) < 1e-4
    assert CONFIG.press_distance <= run.pose.x < CONFIG.press_distance + 0.01
    assert run.commands[-3].v == pytest.approx(CONFIG.contact_speed)
    mirrored = Run(CONFIG._replace(dock_backward=True)).drive(Pose(-start.x, -start.y, start.theta))
    # Rounding may differ, because the drive to the staging pose has other angles.
    np.testing.assert_allclose(mirrored.commands, np.multiply(run.commands, (-1.0, 1.0)), atol=1e-9)


def test_a_robot_that_stands_within_press_distance_is_docked_and_one_before_it_is_not():
    run = Run(wall=-0.01).drive(OUT)
    assert run.pose.x == -0.01
    assert run.memory.reached
    # The stall time begins with the last centimetre.
    assert 0.5 < DT * run.poses.count(run.pose) < 0.8
    # A robot that stands farther before the dock retreats and tries again.
    far = Run(wall=-CONFIG.press_distance - 0.005).drive(OUT, 20.0, until=(DOCKED, RETREATING))
    assert (far.memory.stage.phase, far.memory.stage.tries) == (RETREATING, 1)
    assert docking._COMMIT_TIMEOUT <= DT * far.poses.count(far.pose) < docking._COMMIT_TIMEOUT + 1.0


@pytest.mark.parametrize(("wall", "farthest"), [(-0.01, -0.01), (math.inf, CONFIG.press_distance + 0.01)])
def test_with_an_open_switch_a_robot_is_not_docked_and_drives_not_farther_than_press_distance(wall, farthest):
    run = Run(wall=wall, contact=NO_CONTACT).drive(OUT, until=(DOCKED, RETREATING))
    assert (run.memory.stage.phase, run.memory.stage.tries) == (RETREATING, 1)
    assert 0.0 <= farthest - run.pose.x < 0.01


def test_contact_ends_a_docking_at_the_dock_and_breaks_off_an_approach_far_before():
    run = Run(seen=lambda pose: Estimate(pose._replace(x=min(pose.x, -0.04))), wall=-0.01)
    with pytest.raises(pytest.fail.Exception, match="still approaching"):
        run.drive(OUT, 9.0)
    run.contact = CONTACT
    run.drive(run.pose)
    assert (run.memory.reached, run.pose.x) == (True, -0.01)
    far = Run().drive(OUT, until=(APPROACHING,))
    far.contact = CONTACT
    assert far.drive(far.pose, until=(RETREATING,)).memory.stage.tries == 1
    docked = Run(contact=CONTACT).drive(Pose(0.002, -0.003, 0.004))
    assert (docked.memory.reached, docked.commands) == (True, [(0.0, 0.0)])


def test_a_lateral_jump_of_the_estimate_breaks_off_the_approach_and_the_last_try_fails():
    def jumping(pose):
        return Estimate(pose._replace(y=pose.y + (0.05 if -0.3 < pose.x < -0.2 else 0.0)))

    run = Run(seen=jumping).drive(OUT, until=(RETREATING,))
    assert run.memory.stage.tries == 1
    assert -0.3 < run.pose.x < -0.25
    run.drive(run.pose)
    assert run.phases == [APPROACHING, *(RETREATING, STAGING, APPROACHING) * 2, RETREATING, FAILED]
    assert run.pose.x <= -CONFIG.staging_distance - 0.04
    assert not run.memory.reached
    assert Docking.reason_to_give_up(run.memory, CONFIG).startswith("3 approaches broken off")


def test_an_uncertain_robot_waits_at_commit_distance_and_breaks_off():
    rng, nearest = random.Random(3), []

    def vague(pose):
        nearest.append(pose.x)
        return Estimate(pose._replace(x=pose.x + rng.gauss(0.0, 0.002)), VAGUE)

    run = Run(seen=vague).drive(OUT, until=(RETREATING,))
    assert run.memory.stage.tries == 1
    assert max(nearest) < -CONFIG.commit_distance + 0.006
    slow = sum(abs(command.v) < 0.03 for command in run.commands[40:])
    assert docking._COMMIT_TIMEOUT <= slow * DT < docking._COMMIT_TIMEOUT + 2.0
    run.drive(run.pose)
    assert (run.memory.stage.phase, run.memory.stage.tries) == (FAILED, CONFIG.dock_tries)


def test_a_robot_that_becomes_certain_continues_and_stays_committed():
    seen = []

    def once(pose):
        seen.append(pose.x)
        return Estimate(pose, CERTAIN if 140 <= len(seen) < 150 else VAGUE)

    run = Run(seen=once).drive(OUT)
    assert run.memory.reached
    assert seen[139] == pytest.approx(-CONFIG.commit_distance, abs=0.01)


def test_an_uncertain_pose_that_jumps_to_the_dock_does_not_count_as_docked():
    run = Run(seen=lambda pose: Estimate(pose, VAGUE)).drive(Pose(-0.5, 0.0, 0.0), until=(APPROACHING,))
    run.drive(Pose(0.1, 0.0, 0.0), until=(DOCKED, RETREATING))
    assert (run.memory.stage.phase, run.memory.stage.tries) == (RETREATING, 1)


@pytest.mark.parametrize("backward", [False, True])
def test_undocking_drives_out_along_the_axis_even_if_reversing_is_forbidden(backward):
    sign = -1.0 if backward else 1.0
    start, goal = Pose(0.0, sign * 0.01, 0.05), Pose(sign * OUT.x, 0.0, 0.0)
    drive = CONFIG.drive._replace(allow_backward=False)
    run = Run(CONFIG._replace(dock_backward=backward, drive=drive), goal).drive(start)
    assert run.phases == [UNDOCKING, UNDOCKED]
    assert run.memory.reached
    assert run.pose == pytest.approx((sign * -0.68, 0.0, 0.0), abs=5e-3)
    assert all(sign * command.v <= 0.0 for command in run.commands)


@pytest.mark.parametrize("goal", [Pose(-0.7, 0.1, 0.0), Pose(-0.7, 0.0, 0.1), Pose(0.5, 0.0, 0.0), Pose(0.0, 0.0, 3.0)])
def test_another_goal_fails_with_the_reason_at_once(goal):
    run = Run(goal=goal).drive(ORIGIN)
    assert (run.phases, run.commands) == ([FAILED], [(0.0, 0.0)])
    reason = "the goal is neither the docked pose nor on the axis before the dock"
    assert Docking.reason_to_give_up(run.memory, CONFIG) == reason


@pytest.mark.parametrize(("latency", "lag"), [(0.2, 0.0), (0.15, 0.1)])
def test_it_docks_in_spite_of_dead_time_and_lag(latency, lag):
    sheet = SHEET._replace(command_latency=latency, drive_time_constant=lag)
    run = Run(CONFIG._replace(drive=SwitchingConfig(data_sheet=sheet))).drive(Pose(-1.5, 0.3, 0.3))
    assert (run.memory.stage.phase, run.memory.stage.tries) == (DOCKED, 0)
    assert abs(run.pose.y) < 0.01
    assert abs(run.pose.theta) < 0.01


NUMBER = st.one_of(st.floats(-3.0, 0.5), st.floats(-0.05, 0.05), st.just(math.nan))
SIGMA = st.sampled_from((0.0, 1e-3, 0.02, 1.0, math.inf, math.nan))
STEP = st.tuples(NUMBER, NUMBER, NUMBER, SIGMA, SIGMA, st.sampled_from((0.0, 0.02, 0.1)))
ON_AXIS = st.sampled_from((STAGING, APPROACHING, RETREATING, DOCKED, FAILED, UNDOCKING, UNDOCKED))


@settings(max_examples=150)
@given(
    ON_AXIS,
    st.booleans(),
    st.booleans(),
    st.sampled_from((ORIGIN, OUT, Pose(1.0, 2.0, 3.0))),
    st.sampled_from((CONTACT_UNKNOWN, NO_CONTACT, CONTACT)),
    st.lists(STEP, max_size=12),
)
def test_the_commands_are_finite_and_within_the_limits_for_any_estimates(
    phase, backward, accelerates_at_once, goal, contact, steps
):
    sheet = DataSheet(0.5, 1.5, 9.0) if accelerates_at_once else SHEET
    config = DockingConfig(dock_backward=backward, drive=SwitchingConfig(data_sheet=sheet))
    memory, before = new_docking_memory(config), Twist(0.2, 0.3)
    memory = memory._replace(stage=memory.stage._replace(phase=phase), command=before)
    for x, y, theta, xy, sigma, dt in steps:
        seen = Observation(Estimate(Pose(x, y, theta), Uncertainty(xy, sigma)), dt, 0.1, contact)
        memory, command, _ = docking_step(memory, seen, goal, config)
        assert abs(command.v) <= SHEET.v_max + 1e-12
        assert abs(command.omega) <= SHEET.omega_max + 1e-12
        assert abs(command.v) + 0.5 * SHEET.wheels.wheel_separation * abs(command.omega) <= 9.0 * 0.05 + 1e-12
        if math.isnan(x + y + theta):
            # A pose that is not finite stops the robot at once.
            assert command == (0.0, 0.0) or memory.stage.phase in (DOCKED, FAILED, UNDOCKED)
        elif not accelerates_at_once:
            assert abs(command.v - before.v) <= SHEET.a_max * dt + 1e-12
            assert abs(command.omega - before.omega) <= SHEET.omega_dot_max * dt + 1e-12
        before = command
