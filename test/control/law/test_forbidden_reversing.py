"""``allow_backward`` set to false while the robot reverses: it brakes within its limits and never reverses again."""

import random

import pytest
from driven import T_S, Run

from diffbot_control.law.configuration import DockingConfig
from diffbot_control.law.docking import DOCKED, STAGING, Docking
from diffbot_control.law.regions import OMEGA_G, OMEGA_L, Switching
from diffbot_control.law.registry import PRESETS
from diffbot_control.law.steering import BACKWARD, FORWARD, UNDECIDED, Approach
from diffbot_control.law.switching import new_memory
from diffbot_core.kinematics import Twist

A_MAX, OMEGA_DOT_MAX = 0.8, 3.0
ROUNDING = 1e-12
LAGGING = {"command_latency": 0.2, "drive_time_constant": 0.1}


def limited(name="tuned", **sheet):
    config = PRESETS[name].config
    sheet = config.data_sheet._replace(a_max=A_MAX, omega_dot_max=OMEGA_DOT_MAX, **sheet)
    return config._replace(data_sheet=sheet)


def forward(config):
    """Return a configuration of a law, or of docking, that must not reverse."""
    if isinstance(config, DockingConfig):
        return config._replace(drive=forward(config.drive))
    return config._replace(allow_backward=False)


def drive_until(run, condition):
    """Advance until the robot reverses and ``condition(memory)`` is true."""
    for _ in range(600):
        if run.advance().v < -0.02 and condition(run.memory):
            return
    raise AssertionError("the robot did not reach this state")


def check_forbidden(run, steps=600, done=lambda memory: memory.reached, arrives=True):
    """Forbid reversing; check each command against the one before, and that the robot ``arrives``."""
    run.config = forward(run.config)
    before = run.commands[-1]
    assert before.v < 0.0
    for _ in range(steps):
        command = run.advance()
        assert command.v >= min(before.v + A_MAX * T_S, 0.0) - ROUNDING, "braked as hard as the limit allows"
        assert abs(command.v - before.v) <= A_MAX * T_S + ROUNDING
        assert abs(command.omega - before.omega) <= OMEGA_DOT_MAX * T_S + ROUNDING
        if done(run.memory):
            return
        before = command
    assert not arrives, run.memory


@pytest.mark.parametrize(
    ("preset", "start", "sheet", "speed"),
    [
        ("tuned", (6.0, 0.0, 0.0), {}, 0.9),
        ("tuned", (4.0, 2.0, 1.0), LAGGING, 0.9),
        ("paper", (3.0, 0.0, 0.0), {}, 0.5),
    ],
)
def test_the_robot_brakes_within_its_limits_and_arrives_forwards(preset, start, sheet, speed):
    run = Run(start, limited(preset, **sheet), 0, law=PRESETS[preset].law)
    drive_until(run, lambda memory: memory.command.v < -speed)
    check_forbidden(run)


def test_at_once_without_limits_of_acceleration():
    run = Run((6.0, 0.0, 0.0), PRESETS["tuned"].config, 0)
    drive_until(run, lambda memory: memory.command.v <= -1.0)
    run.config = forward(run.config)
    assert all(run.advance().v >= 0.0 for _ in range(300))
    assert run.memory.reached


@pytest.mark.parametrize(("sheet", "states"), [({}, 60), (LAGGING, 10)])
def test_in_any_state_of_the_law(sheet, states):
    """Random states include some that the drives of the other tests do not reach."""
    number = random.Random(7)
    for _ in range(states):
        memory = new_memory()._replace(
            switching=Switching(number.choice((OMEGA_G, OMEGA_L)), 1, number.choice((0.0, 5.0))),
            command=Twist(-number.uniform(0.1, 1.3), number.uniform(-1.0, 1.0)),
            approach=Approach(number.choice((UNDECIDED, FORWARD, BACKWARD)), number.random() < 0.5),
        )
        config = limited(**sheet)._replace(symmetric_yaw_tolerance=number.random() < 0.5)
        reach = 10.0 ** number.uniform(-2.0, 0.7)
        start = [number.uniform(-reach, reach), number.uniform(-reach, reach), number.uniform(-3.1, 3.1)]
        run = Run(start, config, 0, memory=memory)
        run.commands.append(memory.command)
        check_forbidden(run, 100, done=lambda memory: memory.command.v >= 0.0 and memory.reached, arrives=False)


def test_on_the_way_to_the_dock():
    drive = limited()
    drive = drive._replace(data_sheet=drive.data_sheet._replace(v_max=0.5))
    run = Run((0.5, 1.0, 0.0), DockingConfig(drive=drive), 0, law=Docking)
    drive_until(run, lambda memory: memory.stage.phase == STAGING)
    check_forbidden(run, done=lambda memory: memory.stage.phase == DOCKED)
