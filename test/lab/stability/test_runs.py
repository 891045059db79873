"""Runs of the library's own step, from random memories, agree with a certificate."""

import math

import numpy as np
import pytest
from noise_rows import noise_row
from tuned_steps import CONFIG, SHEET

from diffbot_control.law.law import CONTACT_UNKNOWN, Observation
from diffbot_control.law.regions import OMEGA_G, OMEGA_L
from diffbot_control.law.switching import new_memory, step
from diffbot_core.geometry import Pose
from diffbot_core.uncertainty import Estimate, Uncertainty
from diffbot_lab.stability.plan import Contract, Plan, ideal_law, requested_command
from diffbot_lab.stability.runs import ContractLoop, next_pose, random_memory, sample
from diffbot_sim.config import PlantConfig
from diffbot_sim.plant import new_plant, plant_step

LOOP = ContractLoop(ideal_law(CONFIG, Plan()), Contract(), 0.1)
GOAL = Pose(0.0, 0.0, 0.0)


def test_a_step_equals_a_step_of_the_controller_and_the_plant():
    rng = np.random.default_rng(1)
    pose, memory, expected_memory, regions = Pose(-0.7, 0.3, 0.4), new_memory(), new_memory(), set()
    state = new_plant(pose)
    for _ in range(120):
        x, y = 0.7 * rng.uniform(-1.0, 1.0, 2)
        theta, left, right = rng.uniform(-1.0, 1.0, 3)
        seen = Pose(pose.x + 0.06 * x, pose.y + 0.06 * y, pose.theta + 0.03 * theta)
        observation = Observation(Estimate(seen, Uncertainty(0.02, 0.01)), 0.1, 0.1, CONTACT_UNKNOWN)
        expected_memory, command, report = step(expected_memory, observation, GOAL, CONFIG)
        state = plant_step(state, command, noise_row(left, right), PlantConfig())
        pose, memory, rho = next_pose(LOOP, pose, memory, 0.02, (x, y, theta, left, right, 0.0, 0.0, 0.0))
        assert pose == pytest.approx(state.pose, abs=1e-12)
        assert memory == expected_memory
        assert rho == report.rho
        regions.add(memory.switching.region)
    assert regions == {OMEGA_G, OMEGA_L}


def test_a_request_is_the_command_without_acceleration_limits_with_the_gains_of_the_limited_base():
    """If the last command equals the request, the acceleration limits do not change the command."""
    limited = CONFIG._replace(data_sheet=SHEET._replace(a_max=0.5, omega_dot_max=1.5))
    law, rng = ideal_law(limited, Plan(Contract(eps_v=0.02, eps_omega=0.1))), np.random.default_rng(4)
    for _ in range(300):
        rho, angle, theta = rng.uniform(0.0, 1.0) ** 2, *rng.uniform(-math.pi, math.pi, 2)
        seen = Estimate(Pose(rho * math.cos(angle), rho * math.sin(angle), theta), Uncertainty(0.05, 0.01))
        memory = random_memory(ContractLoop(law, Contract(), 0.1), rng)
        observation = Observation(seen, 0.1, 0.1, CONTACT_UNKNOWN)
        requested = requested_command(law, step(memory, observation, GOAL, limited)[0], seen)
        repeated = step(memory._replace(command=requested), observation, GOAL, limited)
        if repeated[0].switching.region == step(memory, observation, GOAL, limited)[0].switching.region:
            assert repeated[1] == pytest.approx(requested, abs=1e-12)


def test_the_position_error_never_exceeds_the_contract():
    """An error of three bounds moves the robot like an error of one bound."""
    one, half, three = (
        next_pose(LOOP, Pose(-0.5, 0.0, 0.0), new_memory(), 0.02, (x, *[0.0] * 7))[0] for x in (1.0, 0.5, 3.0)
    )
    assert three == pytest.approx(one, abs=1e-12)
    assert one.x < half.x


def test_random_steps_from_random_memories_confirm_ranks_and_refute_wrong_ranks(certificate):
    found = sample(certificate, 200_000, 5)
    assert (found.left_core, found.broken) == (0, 0)
    assert found.steps > 150_000
    assert found.from_core > 50_000
    assert found.departures > 10
    short = np.where(certificate.ranks > 3, 3, certificate.ranks).astype(np.int16)
    assert sample(certificate._replace(ranks=short), 40_000, 5).broken > 0
