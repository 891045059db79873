"""The bounds of the arena without casadi: check by the plant, errors of the command, what an interrupt keeps."""

import json
import math
import sys

import numpy as np
import pytest

from diffbot_core.data_sheet import DataSheet, least_time
from diffbot_core.geometry import Pose
from diffbot_core.schema import build
from diffbot_lab.arena.bounds import command as bound
from diffbot_lab.arena.bounds.drive import AT_THE_POSE, GUESSES, INTO_TOLERANCE, Drive, arrives, guessed, sampled
from diffbot_lab.arena.cases import LIMITS, arena_starts, cases_named, world_of
from diffbot_lab.arena.statistics import figures_of
from diffbot_sim.compiled.batch import COLUMNS
from diffbot_tools import cli

PERIOD = 0.1
(ACCELERATION,) = cases_named(("acceleration",))
PLANT, _, _ = world_of(ACCELERATION)
SHEET = build(DataSheet, {**LIMITS, **ACCELERATION.sheet})


def bang_bang(steps_up, steps_at_top, acceleration):
    """Return held velocities that rise, stay and fall as fast as they may."""
    up = acceleration * PERIOD * np.arange(1, steps_up + 1)
    return np.concatenate([up, np.full(steps_at_top, up[-1]), up[::-1]])


def straight(speeds):
    """Return the drive along x with these speeds, and the start from which it ends at the goal."""
    commands = np.column_stack((speeds, np.zeros(len(speeds))))
    return Drive(commands, PERIOD, len(speeds)), Pose(-PERIOD * float(np.sum(speeds)), 0.0, 0.0)


@pytest.mark.parametrize("steps_at_top", [0, 40])
def test_a_bang_bang_drive_arrives_in_the_time_of_the_closed_form(steps_at_top):
    drive, start = straight(bang_bang(26, steps_at_top, 0.5))
    assert arrives(start, drive, PLANT, SHEET, AT_THE_POSE)
    s, v, a = -start.x, 1.3, 0.5
    assert drive.time == pytest.approx(s / v + v / a - PERIOD)  # trapezium; at 0 steps its limit, the triangle
    assert least_time(s, v, a, PERIOD) == pytest.approx(drive.time)
    assert least_time(s, v, math.inf) == pytest.approx(s / v)


def changed(drive, index, command):
    commands = drive.commands.copy()
    commands[index] = command
    return drive._replace(commands=commands)


def test_a_drive_beyond_a_limit_does_not_count():
    drive, start = straight(bang_bang(26, 40, 0.5))
    anywhere = AT_THE_POSE._replace(xy=100.0, yaw=10.0)
    assert arrives(start, drive, PLANT, SHEET, anywhere)
    for index, command in ((0, (0.06, 0.0)), (30, (1.31, 0.0)), (30, (1.3, 0.1)), (65, (0.0, 0.16))):
        assert not arrives(start, changed(drive, index, command), PLANT, SHEET, anywhere), command
    free, _, _ = world_of(cases_named(("nominal",))[0])
    turning = changed(drive, 30, (0.0, 2.61))
    assert not arrives(start, turning, free, build(DataSheet, dict(LIMITS)), anywhere)
    assert not arrives(start, drive._replace(commands=drive.commands[:-5]), PLANT, SHEET, anywhere), "not at rest"


def test_a_drive_that_misses_or_leaves_the_target_does_not_count():
    drive, start = straight(bang_bang(26, 40, 0.5))
    assert not arrives(start._replace(x=start.x - 0.002), drive, PLANT, SHEET, AT_THE_POSE)
    assert not arrives(start._replace(theta=0.002), drive, PLANT, SHEET, AT_THE_POSE)
    # 5 periods earlier it is 0.1 s * (0.25 + 0.2 + 0.15 + 0.1 + 0.05) m/s = 0.075 m before the goal, and brakes inside.
    earlier = drive._replace(arrival=drive.arrival - 5)
    assert arrives(start, earlier, PLANT, SHEET, INTO_TOLERANCE)
    assert not arrives(start, earlier, PLANT, SHEET, AT_THE_POSE)
    assert not arrives(start._replace(x=start.x + 0.15), earlier, PLANT, SHEET, INTO_TOLERANCE), "drives through"


@pytest.mark.parametrize("guess", GUESSES)
def test_a_guess_leads_from_the_start_to_the_goal(guess):
    for row in arena_starts().tolist():
        corners, total = guessed(Pose(*row), guess, SHEET)
        assert corners[0, 1:] == pytest.approx(row)
        assert corners[-1, :3] == pytest.approx([total, 0.0, 0.0])
        assert math.remainder(corners[-1, 3], 2.0 * math.pi) == pytest.approx(0.0, abs=1e-9)
        assert total > math.hypot(*row[:2]) / 1.3
        assert sampled(corners, np.array([0.0, total + 1.0]))[-1] == pytest.approx(corners[-1, 1:])


def test_without_casadi_the_command_says_what_to_install(monkeypatch, tmp_path, capsys, kept_signal_handlers):
    monkeypatch.setitem(sys.modules, "casadi", None)
    assert cli.main(["benchmark", "bound", "--out", str(tmp_path)]) == 1
    written = capsys.readouterr()
    assert written.err == "diffbot: diffbot benchmark bound needs casadi: pip install 'casadi>=3.6'\n"
    assert list(tmp_path.iterdir()) == []


def test_an_interrupt_keeps_the_cases_that_are_finished(monkeypatch, tmp_path, capsys, kept_signal_handlers):
    def driven(entry, case, options, report):
        if case.name == "acceleration":
            raise KeyboardInterrupt
        return {"name": entry.name, "label": entry.label} | figures_of(np.zeros((2, len(COLUMNS))))

    times = {"target": "t", "confirmed": 17, "median": 1.0, "max": 2.0}
    monkeypatch.setattr(bound, "load_casadi", lambda: None)
    monkeypatch.setattr(bound, "version", lambda name: f"version of {name}")
    monkeypatch.setattr(bound, "_least_times", lambda case, target, report: times)
    monkeypatch.setattr(bound, "_driven", driven)
    assert cli.main(["benchmark", "bound", "--runs", "3", "--seed", "5", "--out", str(tmp_path)]) == 130
    kept = json.loads((tmp_path / "bound.json").read_text())
    assert [case["name"] for case in kept["cases"]] == ["nominal", "dead_time_03"]
    assert kept["command"] == "diffbot benchmark bound --runs 3 --seed 5"
    assert (kept["casadi"], kept["seed"], kept["runs_of_each_start"]) == ("version of casadi", 5, 3)
