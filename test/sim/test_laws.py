"""The compiled loop: one compiler at a time. Laws from other packages: versions, plain Python, the answer reached."""

import fcntl
import logging
import math
import sys

import numpy as np
import pytest

from diffbot_control.law.registry import resolve_law
from diffbot_control.law.switching import SwitchingLaw
from diffbot_core.geometry import Pose
from diffbot_lab.cases import Configuration, make_case
from diffbot_sim.batch import Starts, run_batch
from diffbot_sim.fusion import new_buffers
from diffbot_sim.jit import compile_kernel, law_version, source_hash
from diffbot_sim.noise import NoiseSource
from diffbot_sim.robot_step import make_loop
from diffbot_sim.sensors import purposes_of

LAW = """
import math
from typing import NamedTuple
from diffbot_control.law import GoalTolerance, Law, Report
from diffbot_core.data_sheet import DataSheet
from diffbot_core import geometry
from diffbot_core.kinematics import Twist

class Config(NamedTuple):
    gain: float = 0.5
    data_sheet: DataSheet = DataSheet()
    tolerance: GoalTolerance = GoalTolerance()

class Memory(NamedTuple):
    reached: bool

def helper(theta):
    return geometry.wrap_angle(-theta)

def new_memory(config):
    return Memory(False)

def step(memory, observation, goal, config):
    omega = config.gain * helper(observation.estimate.pose.theta)
    return Memory(abs(omega) < 0.01), Twist(0.1, omega), Report(1.0, 0.0, 0.0, 0.0, 0.0, 0, 0.0)

class Turner(Law):
    name = "turner"
    Config = Config
    new_memory = staticmethod(new_memory)
    step = staticmethod(step)
"""
START = Starts(np.array([(0.0, 0.0, 1.0)]))


@pytest.fixture
def write(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(tmp_path)
    names = []

    def law(text, name="turning_law"):
        names.append(name)
        (tmp_path / f"{name}.py").write_text(text)
        sys.modules.pop(name, None)
        return resolve_law(f"{name}:Turner")

    yield law
    for name in names:
        sys.modules.pop(name, None)


TURNED = Pose(0.0, 0.0, 1.0)


def case_for(law, **config):
    return make_case(Configuration(), 5.0, feedback="truth")._replace(controller=law.Config(**config))


def plain_run(law, case, start=TURNED):
    noise = NoiseSource().run(1, 0, case.steps + 1, purposes_of(case.robot.sensors, 0, 0.0))
    return make_loop(law, case.feedback)(case, new_buffers(case.robot), noise, start, np.empty((0, 12)))


def test_a_law_that_does_not_compile_runs_as_plain_python_and_is_logged_once(write, caplog):
    # Numba does not support imports in functions.
    plain = LAW.replace("    return geometry", "    import decimal\n    return geometry")
    law = write(plain.replace('"turner"', '"plain"'), "plain_law")
    with caplog.at_level(logging.WARNING):
        found = [run_batch(case_for(law), START, 1, 0, 1, 1, law)[0] for _ in range(2)]
    logged = [record.getMessage() for record in caplog.records]
    assert len(logged) == 1
    assert logged[0].startswith("law plain runs as plain Python, since numba cannot compile it: ")
    assert "\n" not in logged[0]
    expected = plain_run(law, case_for(law))
    for one in found:
        np.testing.assert_array_equal(one, expected)


def test_the_version_changes_with_the_source(write):
    assert law_version(write(LAW)) == law_version(write(LAW))
    assert law_version(write(LAW)) != law_version(write(LAW + "\n# changed\n", "turning_law_2"))


def test_the_version_does_not_depend_on_the_folder_although_two_files_have_the_same_name(tmp_path):
    def version(installation):
        functions = []
        for package in ("law", "filter"):
            path = tmp_path / installation / package / "config.py"
            path.parent.mkdir(parents=True)
            path.write_text(source := f"def step():\n    return {package!r}\n")
            exec(compile(source, path, "exec"), module := {"__name__": package})
            functions.append(module["step"])
        return source_hash(*functions)

    assert len({version(str(number)) for number in range(20)}) == 1


def test_the_outcome_contains_turning_and_the_time_of_reached():
    case = make_case(Configuration(), 20.0, feedback="truth")
    near, far = (plain_run(SwitchingLaw, case, Pose(x, 0.0, 2.0)) for x in (0.0, 500.0))
    assert near.turning == pytest.approx(2.0, abs=0.2)  # [rad] on the spot
    assert 1.0 < near.reached_time < 10.0
    assert near.false_reached == far.turning == 0.0
    assert math.isnan(far.reached_time)


def test_the_outcome_contains_a_false_reached(write):
    liar = write(LAW.replace("abs(omega) < 0.01", "True"), "lying_law")
    outcome = plain_run(liar, case_for(liar))
    assert (outcome.reached_time, outcome.false_reached) == (0.0, 1.0)


def test_kernels_compile_under_one_lock_so_that_shared_functions_compile_once(monkeypatch):
    kernels = [compile_kernel(lambda x: x + 1), compile_kernel(lambda x: x + 2, "a version")]
    locks = []
    monkeypatch.setattr(
        fcntl, "flock", lambda file, kind: locks.append((file.name, kind, [len(one.overloads) for one in kernels]))
    )
    assert [one(40) for one in kernels] == [41, 42]
    assert [counts for _, _, counts in locks] == [[0, 0], [1, 0]], "each kernel compiles after it has the lock"
    assert {kind for _, kind, _ in locks} == {fcntl.LOCK_EX}
    assert len({name for name, _, _ in locks}) == 1
