"""Steps of the robot itself under the default law, with the errors that a contract allows."""

import math

import numpy as np
from noise_rows import noise_row

from diffbot_control.law.configuration import SwitchingConfig
from diffbot_control.law.steering import FORWARD, drive_and_steer, in_direction, navigation_variables
from diffbot_core.geometry import Pose, wrap_angle
from diffbot_core.kinematics import Twist
from diffbot_lab.stability.plan import Contract, Plan, ideal_law
from diffbot_sim.config import PlantConfig
from diffbot_sim.plant import new_plant, plant_step

CONFIG = SwitchingConfig()
CONTRACT = Contract(sigma_max=0.05, eps_v=0.02, eps_omega=0.05)
PLAN = Plan(CONTRACT)
LAW = ideal_law(CONFIG, PLAN)
SHEET = CONFIG.data_sheet
SLOWING = CONTRACT.sigma_max / CONFIG.sigma_known
"""[-] largest uncertainty ratio of the contract"""
PLANT = PlantConfig()


def moved(rng, pose, command):
    """Return the pose after a step with the largest errors of the wheels and of the base."""
    left, right, more, direction = *rng.choice([-1.0, 1.0], 3), rng.uniform(-math.pi, math.pi)
    turning = Twist(command.v, command.omega + more * CONTRACT.eps_omega)
    after = plant_step(new_plant(pose), turning, noise_row(left, right), PLANT).pose
    beside = PLANT.sampling_time * CONTRACT.eps_v
    return Pose(after.x + beside * math.cos(direction), after.y + beside * math.sin(direction), after.theta)


def measured(pose, errors):
    """Return the estimated pose with errors (x, y, theta) in units of their bounds. The position error is in a disc."""
    x, y, theta = errors
    share = CONTRACT.eps_position / max(1.0, math.hypot(x, y))
    return Pose(pose.x + share * x, pose.y + share * y, wrap_angle(pose.theta + CONTRACT.eps_theta * theta))


def random_step(rng, box, direction):
    """Return the state after a step of Omega_G from a random state of a box (rho, alpha, beta)."""
    r, a, b = (rng.uniform(low, high) for low, high in zip(box[::2], box[1::2], strict=True))
    turned = 0.0 if direction == FORWARD else math.pi
    pose = Pose(-r * math.cos(b + turned), -r * math.sin(b + turned), wrap_angle(b - a))
    errors = np.sign(rng.uniform(-1.0, 1.0, 3)) * rng.choice([1.0, rng.uniform()])
    seen = in_direction(navigation_variables(measured(pose, errors)), direction)
    command = drive_and_steer(seen, SLOWING * rng.uniform(), direction, LAW.gains, SHEET)
    return in_direction(navigation_variables(moved(rng, pose, command)), direction)
