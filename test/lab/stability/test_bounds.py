"""The bounds of the checker hold the robot's own law, limits and plant."""

import math

import numpy as np
import pytest
from tuned_steps import CONFIG, GAINS, PLAN, SHEET, SLOWING, random_local_distance, random_step

from diffbot_control.law.polar_coordinates import Navigation
from diffbot_control.law.steering import BACK, FRONT, drive_and_steer
from diffbot_core.errors import InvalidValueError
from diffbot_lab.stability.check.commands import command_of, numbers_of
from diffbot_lab.stability.check.near import farthest_of_ring
from diffbot_lab.stability.check.steps import Box, after, clipped, motion_of, slice_count, slice_of, with_beta
from diffbot_lab.stability.plan import Contract, Plan, requesting

CHECKER = numbers_of(requesting(CONFIG, PLAN), PLAN)
ROUNDING = 1e-9


def checkers_images(sides):
    """Boxes after one step, as the check of the cells makes them."""
    box = Box(*sides)
    parts = slice_count(CHECKER, box, 0.1)
    for part in range(parts):
        one = slice_of(CHECKER, box, part, parts)
        for others in (-1, 0, 1):
            d0, d1, p, q = with_beta(CHECKER, box, one, others)
            for turns in (-1, 0, 1):
                alpha, beta = clipped(p, q, turns), clipped(box.b0 + d0, box.b1 + d1, others)
                if one.possible and d0 <= d1 and alpha[0] <= alpha[1] and beta[0] <= beta[1]:
                    command = command_of(CHECKER, (one.near, one.far), alpha, beta)
                    yield after(CHECKER, box, *motion_of(CHECKER, command))


def test_commands_of_the_law_are_inside_their_bounds():
    rng = np.random.default_rng(1)
    for _ in range(600):
        near = rng.uniform(0.05, 12.0) ** rng.choice([1.0, 3.0]) % 12.0 + 0.02
        low = np.array([near, *rng.uniform(-math.pi, math.pi, 2)])
        high = np.minimum(low + 0.2 * rng.uniform(size=3), [math.inf, math.pi, math.pi])
        v_low, v_high, omega_low, omega_high = command_of(CHECKER, *zip(low.tolist(), high.tolist(), strict=True))
        for share in (*np.eye(3), *rng.uniform(size=(4, 3)), np.zeros(3), np.ones(3)):
            at = Navigation(*(low + share * (high - low)))
            v, omega = drive_and_steer(at, rng.choice([0.0, SLOWING]), FRONT, GAINS, SHEET)
            assert v_low - ROUNDING <= v <= v_high + ROUNDING, (low, high, at)
            assert omega_low - ROUNDING <= omega <= omega_high + ROUNDING, (low, high, at)


def near_or_around(angle, low, high):
    """True if the angle or one a full turn away is in the interval."""
    return any(low - ROUNDING <= angle + 2.0 * math.pi * turn <= high + ROUNDING for turn in (-1, 0, 1))


@pytest.mark.parametrize("leading", [FRONT, BACK])
def test_states_after_a_step_are_in_the_images_of_their_cell_whichever_end_leads(leading):
    rng = np.random.default_rng(2 + leading)
    for _ in range(50):
        rho = rng.choice([rng.uniform(0.3, 1.0), rng.uniform(1.0, 12.0)])
        alpha, beta = rng.uniform(-math.pi, math.pi - 0.1, 2)
        sides = rho, rho + 0.01, alpha, alpha + 0.04, beta, beta + 0.1
        boxes = list(checkers_images(sides))
        for _ in range(12):
            found = random_step(rng, sides, leading)
            assert any(
                r0 - ROUNDING <= found.rho <= r1 + ROUNDING
                and near_or_around(found.alpha, a0, a1)
                and near_or_around(found.beta, b0, b1)
                for r0, r1, a0, a1, b0, b1 in boxes
            ), (sides, found)


def test_steps_of_omega_l_stay_within_the_checkers_largest_distance_of_their_ring():
    rng = np.random.default_rng(3)
    largest = farthest_of_ring(CHECKER, 0.38, 0.385, 30, 12, 0.06)
    found = [random_local_distance(rng, rng.uniform(0.38, 0.385), rng.uniform(0.0, math.pi)) for _ in range(2000)]
    assert largest - 0.006 < max(found) <= largest


@pytest.mark.parametrize(
    ("field", "value"), [("command_latency", 0.1), ("a_max", 0.5), ("omega_dot_max", 1.5), ("min_velocity", 0.03)]
)
def test_a_base_that_does_not_obey_at_once_needs_a_contract_and_is_certified_by_what_the_law_requests(field, value):
    config = CONFIG._replace(data_sheet=SHEET._replace(**{field: value}))
    with pytest.raises(InvalidValueError, match=r"eps_omega = 0.0: must be above 0 with limits of the acceleration"):
        requesting(config, Plan(Contract(eps_v=0.01)))
    law = requesting(config, Plan(Contract(eps_v=0.01, eps_omega=0.01)))
    assert law._replace(profile_gains=CONFIG.profile_gains) == CONFIG
    # Turning is planned with 0.65 of the limit, driving with 0.86.
    brakes = {"a_max": (0.43, 7.0), "omega_dot_max": (3.0, 0.975)}.get(field, (3.0, 7.0))
    assert (law.profile_gains.brake, law.profile_gains.turn_brake) == pytest.approx(brakes)


def test_wheels_that_cannot_turn_the_robot_as_fast_are_refused():
    with pytest.raises(InvalidValueError, match="omega_max"):
        requesting(CONFIG._replace(data_sheet=SHEET._replace(wheel_max=5.0)), Plan())
