"""The adversary plays by the rules of the loop, and what it reaches is within what is certified."""

import numpy as np
import pytest
from certificates import LAW_17, PAPER_17, coarse_certificate

from diffbot_control.law.controller import new_memory, step
from diffbot_control.law.presets import PAPER, PRESETS
from diffbot_core.geometry import Pose
from diffbot_core.uncertainty import Estimate, Uncertainty
from diffbot_lab.stability.adversary.observe import rank_of
from diffbot_lab.stability.adversary.paper_play import next_state, opponent_of, play
from diffbot_lab.stability.adversary.search import FEATURES, STEPS, WARM_UP, WINDOW, recurrent_distance, search
from diffbot_sim.model.plant import integrate


def test_a_step_is_that_of_the_controller_and_the_plant():
    loop, rng = PAPER_17._replace(eps_P_leave=0.6), np.random.default_rng(1)
    opponent, config = opponent_of(loop), PRESETS[PAPER]
    assert config.region_policy.fixed == opponent.policy
    pose, memory, region, regions = Pose(-0.9, 0.3, 0.4), new_memory(), 0, set()
    for _ in range(60):
        noise = tuple(rng.uniform(-1.0, 1.0, 5))
        seen = Pose(pose.x + 0.3 * noise[0], pose.y + 0.3 * noise[1], pose.theta + 0.17 * noise[2])
        estimate = Estimate(seen, Uncertainty(0.0, 0.0))
        memory, command, _ = step(memory, estimate, Pose(0.0, 0.0, 0.0), 0.1, config)
        twist = command._replace(v=command.v + 0.065 * noise[3], omega=command.omega + 0.2167 * noise[4])
        expected = integrate(pose, twist, 0.1, False)
        pose, region = next_state(opponent, pose, region, noise)
        assert pose == pytest.approx(expected, abs=1e-12)
        assert region == memory.switching.region
        regions.add(region)
    assert regions == {0, 1}


def test_the_recurrent_distance_is_reached_in_every_window():
    path = np.zeros((STEPS, 3))
    path[: WARM_UP - 1, 0] = 9.0
    path[WARM_UP::WINDOW, 1] = 0.5
    path[WARM_UP + WINDOW, 1] = -3.0
    assert recurrent_distance(path) == 0.5
    path[-1, 0] = 7.0
    path[WARM_UP + 2 * WINDOW] = 0.0
    assert recurrent_distance(path) == 0.0


def test_what_is_certified_withstands_the_search():
    loop = LAW_17
    certificate, shown = coarse_certificate(loop), []
    opponent = opponent_of(loop)
    attack = search(
        lambda *where: play(opponent, *where), 0.8, 1, generations=3, population=8, threads=1, each=shown.append
    )
    assert shown == sorted(shown)
    assert shown[-1] == attack.distance == recurrent_distance(attack.path)
    assert 0.03 < attack.distance < certificate.claims.radius
    assert attack.weights.shape == (FEATURES,)
    ranks = rank_of(certificate, attack.path)
    assert (ranks[certificate.claims.steps :] == 0).all()
