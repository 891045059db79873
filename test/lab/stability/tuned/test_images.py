"""The law, the limits and the plant of the robot itself stay inside the bounds that the certificate uses."""

import math

import numpy as np
import pytest

from diffbot_control.law.configuration import ControllerConfig
from diffbot_control.law.polar_coordinates import Navigation, navigation_variables
from diffbot_control.law.steering import BACK, FRONT, drive_and_hold, drive_and_steer, led_by
from diffbot_core.errors import InvalidValueError
from diffbot_core.geometry import Pose, wrap_angle
from diffbot_lab.stability.tuned.certify import tuned_loop
from diffbot_lab.stability.tuned.contract import Contract
from diffbot_lab.stability.tuned.images import Cell3, images, local_distance, most_images
from diffbot_lab.stability.tuned.law import Measured, command_bounds
from diffbot_sim.model.philox import Draw
from diffbot_sim.model.plant import PlantConfig, new_plant, plant_step

CONFIG = ControllerConfig()
GAINS, SHEET = CONFIG.profile_gains, CONFIG.data_sheet
CONTRACT = Contract()
LOOP = tuned_loop(CONFIG, CONTRACT)
PLANT = PlantConfig()
ROUNDING = 1e-9


def moved(pose, command, left, right):
    return plant_step(new_plant(pose), command, Draw(left, right, 0.0, 0.0), PLANT).pose


def measured(pose, errors):
    x, y, theta = errors
    share = CONTRACT.eps_position / max(1.0, math.hypot(x, y))
    return Pose(
        pose.x + share * x,
        pose.y + share * y,
        wrap_angle(pose.theta + CONTRACT.eps_theta * theta),
    )


def near_or_around(angle, low, high):
    """True if the angle or one a full turn away is in the interval."""
    return any(low - ROUNDING <= angle + 2.0 * math.pi * turn <= high + ROUNDING for turn in (-1, 0, 1))


def test_commands_of_the_law_are_inside_their_bounds():
    rng = np.random.default_rng(1)
    for _ in range(1500):
        near = rng.uniform(0.05, 12.0) ** rng.choice([1.0, 3.0]) % 12.0 + 0.02
        alpha, beta = rng.uniform(-math.pi, math.pi, 2)
        wide = 0.2 * rng.uniform(size=3)
        box = Measured(near, near + wide[0], alpha, min(alpha + wide[1], math.pi), beta, min(beta + wide[2], math.pi))
        bounds = command_bounds(LOOP, box)
        for share in (*np.eye(3), *rng.uniform(size=(4, 3)), (0.0, 0.0, 0.0), (1.0, 1.0, 1.0)):
            at = [low + one * (high - low) for one, low, high in zip(share, box[::2], box[1::2], strict=True)]
            v, omega = drive_and_steer(Navigation(*at), CONTRACT.sigma_max, FRONT, GAINS, SHEET)
            assert bounds.v_low - ROUNDING <= v <= bounds.v_high + ROUNDING, (box, at)
            assert bounds.omega_low - ROUNDING <= omega <= bounds.omega_high + ROUNDING, (box, at)


@pytest.mark.parametrize("leading", [FRONT, BACK])
def test_states_after_a_step_are_in_the_images_of_their_cell_whichever_end_leads(leading):
    rng = np.random.default_rng(2 + leading)
    for _ in range(120):
        rho = rng.choice([rng.uniform(0.3, 1.0), rng.uniform(1.0, 12.0)])
        alpha, beta = rng.uniform(-math.pi, math.pi - 0.1, 2)
        cell = Cell3(rho, rho + 0.01, alpha, alpha + 0.04, beta, beta + 0.1)
        out = np.empty((most_images(LOOP, cell, 0.1), 6))
        boxes = out[: images(LOOP, cell, 0.1, out)]
        for _ in range(12):
            r, a, b = (rng.uniform(low, high) for low, high in zip(cell[::2], cell[1::2], strict=True))
            turned = 0.0 if leading == FRONT else math.pi
            pose = Pose(-r * math.cos(b + turned), -r * math.sin(b + turned), wrap_angle(b - a))
            errors = np.sign(rng.uniform(-1.0, 1.0, 3)) * rng.choice([1.0, rng.uniform()])
            seen = led_by(navigation_variables(measured(pose, errors)), leading)
            command = drive_and_steer(seen, CONTRACT.sigma_max * rng.uniform(), leading, GAINS, SHEET)
            after = led_by(navigation_variables(moved(pose, command, *rng.choice([-1.0, 1.0], 2))), leading)
            assert any(
                box[0] - ROUNDING <= after.rho <= box[1] + ROUNDING
                and near_or_around(after.alpha, box[2], box[3])
                and near_or_around(after.beta, box[4], box[5])
                for box in boxes
            ), (cell, pose, errors)


def test_steps_of_omega_l_stay_within_the_largest_local_distance():
    rng, box = np.random.default_rng(3), np.empty(6)
    closest = math.inf
    for alpha in np.arange(0.0, math.pi, 0.25):
        cell = Cell3(0.38, 0.385, alpha, alpha + 0.02, 0.0, 0.0)
        bound = local_distance(LOOP, cell, 0.03, 24, box)
        for _ in range(60):
            beta = rng.uniform(-math.pi, math.pi)
            pose = Pose(-0.385 * math.cos(beta), -0.385 * math.sin(beta), wrap_angle(beta - alpha - 0.01))
            seen = measured(pose, rng.choice([-1.0, 0.0, 1.0], 3))
            command = drive_and_hold(navigation_variables(seen), seen.theta, 0.0, GAINS, SHEET)
            after = moved(pose, command, *rng.choice([-1.0, 1.0], 2))
            closest = min(closest, bound - math.hypot(after.x, after.y))
    assert 0.0 <= closest < 0.005


@pytest.mark.parametrize(
    ("field", "value"), [("command_latency", 0.1), ("a_max", 0.5), ("wheel_max", 5.0), ("min_velocity", 0.03)]
)
def test_a_data_sheet_that_is_not_covered_is_refused_by_name(field, value):
    config = CONFIG._replace(data_sheet=SHEET._replace(**{field: value}))
    with pytest.raises(InvalidValueError, match=field if field != "wheel_max" else "omega_max"):
        tuned_loop(config, CONTRACT)
