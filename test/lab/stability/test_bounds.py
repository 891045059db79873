"""The bounds of a step contain the robot's own law, limits, region switch and plant."""

import math

import numpy as np
import pytest
from tuned_steps import CONFIG, LAW, PLAN, SHEET, SLOWING, measured, moved, random_step

from diffbot_control.law.law import CONTACT_UNKNOWN, Observation
from diffbot_control.law.regions import OMEGA_G, OMEGA_L, Switching
from diffbot_control.law.steering import BACKWARD, FORWARD, Navigation, drive_and_steer
from diffbot_control.law.switching import new_memory, step
from diffbot_core.errors import InvalidValueError
from diffbot_core.geometry import Pose
from diffbot_core.kinematics import Twist
from diffbot_core.uncertainty import Estimate, Uncertainty
from diffbot_lab.stability.checker_bounds import Box, checker_loop, command_of, images, local_reach, max_images
from diffbot_lab.stability.maker_bounds import boxes_of_row, maker_loop
from diffbot_lab.stability.plan import Contract, Plan, ideal_law

LOOP = checker_loop(LAW, PLAN)
ROUNDING = 1e-9
GOAL = Pose(0.0, 0.0, 0.0)


def images_of(sides):
    """Boxes (n, 6) after one step."""
    box = Box(*sides)
    boxes = np.empty((max_images(LOOP, box), 6))
    return boxes[: images(LOOP, box, boxes)]


def test_the_bounds_contain_the_commands_of_the_law():
    rng = np.random.default_rng(1)
    for _ in range(600):
        near = rng.uniform(0.05, 12.0) ** rng.choice([1.0, 3.0]) % 12.0 + 0.02
        low = np.array([near, *rng.uniform(-math.pi, math.pi, 2)])
        high = np.minimum(low + 0.2 * rng.uniform(size=3), [math.inf, math.pi, math.pi])
        v_low, v_high, omega_low, omega_high = command_of(LOOP, *zip(low.tolist(), high.tolist(), strict=True))
        for share in (*np.eye(3), *rng.uniform(size=(4, 3)), np.zeros(3), np.ones(3)):
            at = Navigation(*(low + share * (high - low)))
            v, omega = drive_and_steer(at, rng.choice([0.0, SLOWING]), FORWARD, LAW.gains, SHEET)
            assert v_low - ROUNDING <= v <= v_high + ROUNDING, (low, high, at)
            assert omega_low - ROUNDING <= omega <= omega_high + ROUNDING, (low, high, at)


def near_or_around(angle, low, high):
    """True if the angle or one a full turn away is in the interval."""
    return any(low - ROUNDING <= angle + 2.0 * math.pi * turn <= high + ROUNDING for turn in (-1, 0, 1))


@pytest.mark.parametrize("direction", [FORWARD, BACKWARD])
def test_the_checkers_images_contain_the_states_after_a_step_in_both_directions_of_travel(direction):
    rng = np.random.default_rng(2 + direction)
    for _ in range(60):
        rho = rng.choice([rng.uniform(0.12, 0.4), rng.uniform(0.3, 1.0), rng.uniform(1.0, 12.0)])
        alpha, beta = rng.uniform(-math.pi, math.pi - 0.1, 2)
        sides = rho, rho + 0.01, alpha, alpha + 0.04, beta, beta + 0.1
        boxes = images_of(sides)
        assert len(boxes) > 0
        for _ in range(12):
            found = random_step(rng, sides, direction)
            assert any(
                r0 - ROUNDING <= found.rho <= r1 + ROUNDING
                and near_or_around(found.alpha, a0, a1)
                and near_or_around(found.beta, b0, b1)
                for r0, r1, a0, a1, b0, b1 in boxes
            ), (sides, found)


def test_the_makers_images_contain_the_states_after_a_step():
    rng, loop, alphas, betas = np.random.default_rng(6), maker_loop(LAW, PLAN), 144, 64
    for _ in range(40):
        rho = rng.choice([rng.uniform(0.12, 0.4), rng.uniform(0.3, 1.0), rng.uniform(1.0, 12.0)])
        boxes, start = boxes_of_row(loop, (rho, rho + 0.01), alphas, betas)
        for cell in rng.integers(0, alphas // 2 * betas, 12):
            alpha = 2.0 * math.pi / alphas * (cell // betas)
            beta = 2.0 * math.pi / betas * (cell % betas) - math.pi
            sides = rho, rho + 0.01, alpha, alpha + 2.0 * math.pi / alphas, beta, beta + 2.0 * math.pi / betas
            found = random_step(rng, sides, FORWARD)
            assert any(
                r0 <= found.rho <= r1 and near_or_around(found.alpha, a0, a1) and near_or_around(found.beta, b0, b1)
                for r0, r1, a0, a1, b0, b1 in boxes[start[cell] : start[cell + 1]].tolist()
            ), (rho, alpha, beta, found)


def random_local_state(rng):
    """Return a pose that may be in Omega_L, near the edge of where it may, and a memory there."""
    rho, angle = rng.uniform(0.1, 0.23), rng.uniform(-math.pi, math.pi)
    theta = rng.uniform(-math.pi, math.pi) if rng.random() < 0.5 else 0.0
    command = Twist(0.0, 0.0) if rng.random() < 0.5 else Twist(0.3, 0.5)
    memory = new_memory()._replace(switching=Switching(OMEGA_L, 1, rng.choice([0.0, 10.0])), command=command)
    return Pose(rho * math.cos(angle), rho * math.sin(angle), theta), memory


def test_omega_l_and_departures_from_it_end_within_the_bound_that_the_core_contains():
    rng, farthest, departed = np.random.default_rng(3), 0.0, 0.0
    bound = local_reach(LOOP)
    for _ in range(6000):
        pose, memory = random_local_state(rng)
        seen = measured(pose, rng.choice([-1.0, 0.0, 1.0], 3))
        estimate = Estimate(seen, Uncertainty(rng.choice([0.01, PLAN.contract.sigma_max]), 0.01))
        after, command, report = step(memory, Observation(estimate, 0.1, 0.1, CONTACT_UNKNOWN), GOAL, CONFIG)
        if after.switching.region == OMEGA_L:
            pose = moved(rng, pose, command)
            farthest = max(farthest, math.hypot(pose.x, pose.y))
        elif report.rho <= LOOP.leaving:
            departed = max(departed, math.hypot(pose.x, pose.y))
    assert bound - 0.04 < farthest <= bound
    assert 0.1 < departed <= LOOP.leaving + LOOP.eps_rho < bound


@pytest.mark.parametrize("tolerance", [0.1, 0.4])
def test_the_law_is_in_omega_g_beyond_the_leaving_radius_whatever_the_uncertainty(tolerance):
    config = CONFIG._replace(tolerance=CONFIG.tolerance._replace(xy_goal_tolerance=tolerance))
    radius = checker_loop(ideal_law(config, PLAN), PLAN).leaving
    before = new_memory()._replace(switching=Switching(OMEGA_L, 1, 0.0), command=Twist(0.2, 0.0))
    for rho in np.linspace(0.02, 3.0, 75):
        found = set()
        for sigma in np.linspace(0.0, PLAN.contract.sigma_max, 12):
            seen = Estimate(Pose(0.0, rho, 0.0), Uncertainty(sigma, 0.0))
            found.add(step(before, Observation(seen, 0.1, 0.1, CONTACT_UNKNOWN), GOAL, config)[2].region)
        assert found == ({OMEGA_L} if rho <= tolerance else {OMEGA_L, OMEGA_G} if rho <= radius else {OMEGA_G})


@pytest.mark.parametrize(
    ("field", "value"), [("command_latency", 0.1), ("a_max", 0.5), ("omega_dot_max", 1.5), ("min_velocity", 0.03)]
)
def test_a_base_with_delays_or_limits_needs_bounds_of_the_base_and_is_certified_by_the_requested_command(field, value):
    config = CONFIG._replace(data_sheet=SHEET._replace(**{field: value}))
    with pytest.raises(InvalidValueError, match=r"eps_omega = 0.0: must be above 0 with limits of the acceleration"):
        ideal_law(config, Plan(Contract(eps_v=0.01)))
    law = ideal_law(config, Plan(Contract(eps_v=0.01, eps_omega=0.01)))
    assert law.config == CONFIG
    # Turning is planned with 0.65 of the limit, driving with 0.86.
    brakes = {"a_max": (0.43, 7.0), "omega_dot_max": (3.0, 0.975)}.get(field, (3.0, 7.0))
    assert (law.gains.brake, law.gains.turn_brake) == pytest.approx(brakes)


@pytest.mark.parametrize(
    ("config", "name"),
    [
        (CONFIG._replace(data_sheet=SHEET._replace(wheel_max=5.0)), "omega_max"),
        (CONFIG._replace(data_sheet=SHEET._replace(v_max=math.inf)), "v_max"),
        (CONFIG._replace(allow_backward=False), "allow_backward"),
        (CONFIG._replace(symmetric_yaw_tolerance=True), "symmetric_yaw_tolerance"),
    ],
)
def test_an_uncovered_configuration_is_refused_by_the_name_of_its_parameter(config, name):
    with pytest.raises(InvalidValueError, match=name):
        ideal_law(config, Plan())
