"""The adversary plays by the rules of the loop; random runs keep to the ranks; the search stays within the bounds."""

import numpy as np
import pytest

from diffbot_control.law.configuration import ControllerConfig, new_memory
from diffbot_control.law.controller import step
from diffbot_core.geometry import Pose
from diffbot_core.uncertainty import Estimate, Uncertainty
from diffbot_lab.stability.adversary.play import observe, play
from diffbot_lab.stability.adversary.search import STEPS, WARM_UP, WINDOW, recurrent_distance, search
from diffbot_lab.stability.plan import Contract
from diffbot_lab.stability.runs import ContractLoop, loop_of, next_pose
from diffbot_sim.model.philox import Draw
from diffbot_sim.model.plant import PlantConfig, new_plant, plant_step

LOOP = ContractLoop(ControllerConfig(), Contract(), 0.1)


def test_a_step_is_that_of_the_controller_and_the_plant():
    rng = np.random.default_rng(1)
    pose, memory, expected_memory, regions = Pose(-0.7, 0.3, 0.4), new_memory(), new_memory(), set()
    state = new_plant(pose)
    for _ in range(120):
        x, y = 0.7 * rng.uniform(-1.0, 1.0, 2)
        theta, left, right = rng.uniform(-1.0, 1.0, 3)
        seen = Pose(pose.x + 0.06 * x, pose.y + 0.06 * y, pose.theta + 0.03 * theta)
        expected_memory, command, _ = step(
            expected_memory, Estimate(seen, Uncertainty(0.02, 0.01)), Pose(0.0, 0.0, 0.0), 0.1, LOOP.law
        )
        state = plant_step(state, command, Draw(left, right, 0.0, 0.0), PlantConfig())
        pose, memory = next_pose(LOOP, pose, memory, 0.02, (x, y, theta, left, right, 0.0, 0.0, 0.0))
        assert pose == pytest.approx(state.pose, abs=1e-12)
        assert memory == expected_memory
        regions.add(memory.switching.region)
    assert regions == {0, 1}


def test_the_position_error_never_exceeds_the_contract():
    """The law goes where it sees the goal: an error of three bounds moves the robot as one of one bound does."""
    one, half, three = (
        next_pose(LOOP, Pose(-0.5, 0.0, 0.0), new_memory(), 0.02, (x, *[0.0] * 7))[0] for x in (1.0, 0.5, 3.0)
    )
    assert three == pytest.approx(one, abs=1e-12)
    assert one.x < half.x


def test_random_runs_keep_to_the_ranks_and_find_wrong_ones(certificate):
    found = observe(certificate, 20_000, 300, 3)
    assert found.steps_from_core >= 20_000
    assert (found.left_core, found.late, found.trajectories) == (0, 0, 300)
    assert 0 < found.longest <= certificate.claims.steps
    assert 0.0 < found.farthest < 0.2
    short = np.where(certificate.ranks > 3, 3, certificate.ranks).astype(np.int16)
    assert observe(certificate._replace(ranks=short), 1, 300, 3).late > 0


def test_the_recurrent_distance_is_reached_in_every_window():
    path = np.zeros((STEPS, 3))
    path[: WARM_UP - 1, 0] = 9.0
    path[WARM_UP::WINDOW, 1] = 0.5
    path[WARM_UP + WINDOW, 1] = -3.0
    assert recurrent_distance(path) == 0.5
    path[-1, 0] = 7.0
    path[WARM_UP + 2 * WINDOW] = 0.0
    assert recurrent_distance(path) == 0.0


def test_what_is_certified_withstands_the_search(certificate):
    loop, shown = loop_of(certificate), []
    attack = search(
        lambda *where: play(loop, *where), 0.3, 1, generations=3, population=8, threads=1, each=shown.append
    )
    assert shown == sorted(shown)
    assert shown[-1] == attack.distance == recurrent_distance(attack.path)
    assert 0.03 < attack.distance < certificate.claims.radius
