"""``allow_backward`` set to false while the robot reverses: it brakes within its limits and never reverses again."""

import math
import random

import pytest
from driven import ORIGIN, T_S, Robot

from diffbot_control.law import controller
from diffbot_control.law.controller import new_memory
from diffbot_control.law.docking import DOCKED, STAGING, UNDOCKED, UNDOCKING, DockingConfig, docking_step
from diffbot_control.law.docking import new_docking_memory as docking_memory
from diffbot_control.law.finish import NO_LEG, TO_AND_FRO, V_LEG, Finish
from diffbot_control.law.paper.reapproach import RETREATING, Reapproach
from diffbot_control.law.presets import PRESETS
from diffbot_control.law.regions import OMEGA_G, OMEGA_L, Switching
from diffbot_control.law.steering import BACK, FRONT, UNDECIDED, Course
from diffbot_core.geometry import Pose
from diffbot_core.kinematics import Twist
from diffbot_core.uncertainty import CERTAIN, Estimate, Uncertainty

A_MAX, OMEGA_DOT_MAX = 0.8, 3.0
ROUNDING = 1e-12
LAGGING = {"command_latency": 0.2, "drive_time_constant": 0.1}


def limited(name="tuned", **sheet):
    preset = PRESETS[name]
    sheet = preset.data_sheet._replace(a_max=A_MAX, omega_dot_max=OMEGA_DOT_MAX, **sheet)
    return preset._replace(data_sheet=sheet)


def forward(config):
    """Return a configuration of a law, or of docking, that must not reverse."""
    if isinstance(config, DockingConfig):
        return config._replace(drive=forward(config.drive))
    return config._replace(driving=config.driving._replace(allow_backward=False))


AT_REST = new_memory()._replace(switching=Switching(OMEGA_L))


class Driven:
    """A robot under a law, and its commands."""

    def __init__(self, config, start, goal=ORIGIN, *, memory=None, uncertainty=CERTAIN, step=controller.step):
        sheet = config.drive.data_sheet if isinstance(config, DockingConfig) else config.data_sheet
        self.robot = Robot(start, sheet.command_latency, sheet.drive_time_constant)
        self.config, self.goal, self.uncertainty, self.step = config, goal, uncertainty, step
        self.memory = memory or new_memory()
        self.commands = []

    def advance(self):
        estimate, dt = Estimate(self.robot.pose, self.uncertainty), T_S if self.commands else 0.0
        self.memory, command, _ = self.step(self.memory, estimate, self.goal, dt, self.config)
        self.robot.drive(command)
        self.commands.append(command)
        return command

    def until(self, condition, steps=600):
        """Advance until the robot reverses and ``condition(memory)`` is true."""
        for _ in range(steps):
            if self.advance().v < -0.02 and condition(self.memory):
                return self
        raise AssertionError("the robot has not come into this state")

    def check_forbidden(self, steps=600, done=lambda memory: memory.reached, arrives=True):
        """Forbid reversing; check each command against the one before, and that the robot ``arrives``."""
        self.config = forward(self.config)
        before = self.commands[-1]
        assert before.v < 0.0
        for _ in range(steps):
            command = self.advance()
            assert command.v >= min(before.v + A_MAX * T_S, 0.0) - ROUNDING, "braked as hard as the limit allows"
            assert abs(command.v - before.v) <= A_MAX * T_S + ROUNDING
            assert abs(command.omega - before.omega) <= OMEGA_DOT_MAX * T_S + ROUNDING
            if done(self.memory):
                return
            before = command
        assert not arrives, self.memory


@pytest.mark.parametrize("sheet", [{}, LAGGING])
@pytest.mark.parametrize("start", [(6.0, 0.0, 0.0), (4.0, 2.0, 1.0), (3.0, -3.0, -1.2)])
def test_far_from_the_goal(start, sheet):
    run = Driven(limited(**sheet), start).until(lambda memory: memory.command.v < -0.9)
    assert run.memory.switching.region == OMEGA_G
    run.check_forbidden()


@pytest.mark.parametrize("sheet", [{}, LAGGING])
def test_near_the_goal(sheet):
    run = Driven(limited(**sheet), (2.0, 0.1, 0.0))
    run.until(lambda memory: memory.switching.region == OMEGA_L and memory.finish.kind == NO_LEG)
    run.check_forbidden()


def test_at_once_without_limits_of_acceleration():
    run = Driven(PRESETS["tuned"], (6.0, 0.0, 0.0)).until(lambda memory: memory.command.v <= -1.0)
    run.config = forward(run.config)
    assert all(run.advance().v >= 0.0 for _ in range(300))
    assert run.memory.reached


@pytest.mark.parametrize(("kind", "lateral", "sigma"), [(TO_AND_FRO, 0.07, 0.005), (V_LEG, 0.12, 0.02)])
def test_on_a_leg_of_the_finish(kind, lateral, sigma):
    run = Driven(limited(), (0.0, lateral, 0.0), memory=AT_REST, uncertainty=Uncertainty(sigma, 0.012))
    run.until(lambda memory: memory.finish.kind == kind)
    run.check_forbidden()
    assert run.memory.finish.kind == NO_LEG


@pytest.mark.parametrize("goal", [Pose(8.0, 1.0, 0.0), Pose(-4.0, 0.0, 0.0), Pose(0.5, 1.0, 2.0)])
def test_with_a_new_goal(goal):
    run = Driven(limited(), (6.0, 0.0, 0.0)).until(lambda memory: memory.command.v < -1.0)
    # As the supervisor begins a goal: the motion is all that stays.
    run.memory = new_memory()._replace(command=run.memory.command, actuation=run.memory.actuation)
    run.goal = goal
    run.check_forbidden()


def test_with_either_heading():
    config = limited()
    config = config._replace(driving=config.driving._replace(symmetric_yaw_tolerance=True))
    run = Driven(config, (4.0, 2.0, 1.0)).until(lambda memory: memory.command.v < -0.9)
    run.check_forbidden()
    assert abs(math.remainder(run.robot.pose.theta, math.pi)) < 0.01


@pytest.mark.parametrize("preset", ["paper", "paper_covariance"])
def test_with_the_papers_law(preset):
    run = Driven(limited(preset), (3.0, 0.0, 0.0)).until(lambda memory: memory.command.v < -0.5)
    run.check_forbidden()


def test_on_the_papers_reapproach():
    run = Driven(limited("paper_covariance"), (0.0, 0.2, 0.0), memory=AT_REST)
    run.until(lambda memory: memory.reapproach.phase == RETREATING)
    run.check_forbidden()


@pytest.mark.parametrize("preset", ["tuned", "paper_covariance"])
@pytest.mark.parametrize(("sheet", "states"), [({}, 60), (LAGGING, 10)])
def test_in_any_state_of_the_law(preset, sheet, states):
    """States that the drives of the other tests do not come to are among them."""
    number = random.Random(7)
    for _ in range(states):
        memory = new_memory()._replace(
            switching=Switching(number.choice((OMEGA_G, OMEGA_L))),
            command=Twist(-number.uniform(0.1, 1.3), number.uniform(-1.0, 1.0)),
            course=Course(number.choice((UNDECIDED, FRONT, BACK)), number.random() < 0.5),
            finish=number.choice((Finish(), Finish(TO_AND_FRO, -1.0, 0.05, 9), Finish(V_LEG, -1.0, 0.4, 2))),
            reapproach=number.choice((Reapproach(), Reapproach(RETREATING, 1, 0, 1.0, 0.4))),
        )
        reach = 10.0 ** number.uniform(-2.0, 0.7)
        start = [number.uniform(-reach, reach), number.uniform(-reach, reach), number.uniform(-3.1, 3.1)]
        run = Driven(limited(preset, **sheet), start, memory=memory)
        run.commands.append(memory.command)
        run.check_forbidden(100, done=lambda memory: memory.command.v >= 0.0 and memory.reached, arrives=False)


def docking(start, **options):
    drive = limited()
    drive = drive._replace(data_sheet=drive.data_sheet._replace(v_max=0.5))
    return Driven(
        DockingConfig(drive=drive), start, memory=docking_memory(DockingConfig()), step=docking_step, **options
    )


def test_on_the_way_to_the_dock():
    run = docking((0.5, 1.0, 0.0)).until(lambda memory: memory.phase == STAGING)
    phases = set()

    def done(memory):
        phases.add(memory.phase)
        return memory.phase == DOCKED

    run.check_forbidden(done=done)
    assert STAGING in phases


def test_a_robot_backs_out_of_its_dock_all_the_same():
    run = docking((0.0, 0.0, 0.0), goal=Pose(-0.7, 0.0, 0.0))
    run.config = forward(run.config)
    run.until(lambda memory: memory.phase == UNDOCKING)
    while run.memory.phase == UNDOCKING:
        run.advance()
    assert run.memory.phase == UNDOCKED
