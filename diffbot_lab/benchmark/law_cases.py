"""What the benchmark of the law compares: laws, starts, and harder cases for this project's own law."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from diffbot_control.filter.options import CALIBRATING, EKF, FilterConfig
from diffbot_control.law.controller import ControllerConfig
from diffbot_control.law.goal_checker import GoalTolerance
from diffbot_control.law.presets import PAPER, PAPER_COVARIANCE, PRESETS, TUNED
from diffbot_core.geometry import Pose
from diffbot_lab.cases import Configuration, make_case
from diffbot_lab.paper.scenarios import GOAL, HEADINGS_B, starts_of
from diffbot_sim.compiled import peer_laws as peers
from diffbot_sim.compiled.closed_loop import Case
from diffbot_sim.model.actuators import ActuatorConfig
from diffbot_sim.model.plant import PlantConfig
from diffbot_sim.model.sensors import SensorConfig

Array = NDArray[np.float64]

DURATION = 60.0
"""[s] of a run"""
XY_TOLERANCE, YAW_TOLERANCE = 0.1, 0.1
"""[m], [rad] within which a run has to end"""
V_MAX = 1.3
"""[m/s] bound of |v| for every law; no run takes less than distance / V_MAX"""


class Law(NamedTuple):
    """One law of the comparison."""

    name: str
    label: str
    peer: int
    controller: ControllerConfig
    source: str
    purpose: str


class Challenge(NamedTuple):
    """A harder case for this project's law."""

    name: str
    text: str
    controller: ControllerConfig
    plant: PlantConfig = PlantConfig()
    sensors: SensorConfig = SensorConfig()
    xy_tolerance: float = XY_TOLERANCE
    filter: str = EKF


TUNED_CONTROLLER = PRESETS[TUNED]
_LIMITS_ONLY = ControllerConfig()
_PARK = "J. J. Park, B. Kuipers, ICRA 2011, with the parameters and the finish of nav2_graceful_controller"
_AICARDI = "M. Aicardi et al., IEEE Robotics and Automation Magazine 2 (1995); law (13) of the paper, its gains"
LAWS = (
    Law(
        "tuned",
        "switching law, tuned",
        peers.OURS,
        TUNED_CONTROLLER,
        "law (17) of the paper, gains for a double pole, radius from the covariance (control.md)",
        "go-to-pose in open space with a noisy estimate; forwards or backwards",
    ),
    Law(
        "paper_covariance",
        "switching law, paper's gains",
        peers.OURS,
        PRESETS[PAPER_COVARIANCE],
        "law (17) with the paper's gains, radius from the covariance",
        "what the gains alone change",
    ),
    Law(
        "paper_fixed",
        "switching law, paper's",
        peers.OURS,
        PRESETS[PAPER],
        "law (17) with the paper's gains and a fixed radius of 0.5 m",
        "the paper's law as published; made for a heading, not for a position within 0.1 m",
    ),
    Law(
        "graceful_pose",
        "Park & Kuipers, to the pose",
        peers.GRACEFUL_POSE,
        _LIMITS_ONLY,
        f"{_PARK}, 1.3 m/s, initial rotation, straight to the goal's pose",
        "comfortable forward motion of a wheelchair along a smooth curve to a pose; forwards only",
    ),
    Law(
        "graceful",
        "Nav2 graceful, 1.3 m/s",
        peers.GRACEFUL,
        _LIMITS_ONLY,
        f"{_PARK}, 1.3 m/s, allow_backward, prefer_final_rotation",
        "following a planned path; here straight to the goal, then a rotation in place",
    ),
    Law(
        "graceful_shipped",
        "Nav2 graceful, as shipped",
        peers.GRACEFUL_SHIPPED,
        _LIMITS_ONLY,
        f"{_PARK}, all defaults: 0.5 m/s, target 1 m ahead on the path",
        "following a planned path indoors at 0.33 m/s (a target 1 m ahead is inside its slowdown_radius)",
    ),
    Law(
        "polar",
        "polar law, Siegwart's gains",
        peers.POLAR,
        _LIMITS_ONLY,
        "A. Astolfi, J. Dyn. Syst. Meas. Control 121 (1999); gains of Siegwart and Nourbakhsh (2004)",
        "exponential convergence from an exact pose; textbook",
    ),
    Law(
        "polar_fast",
        "polar law, PythonRobotics",
        peers.POLAR_FAST,
        _LIMITS_ONLY,
        "the same law with gains and sectors of PythonRobotics' move_to_pose",
        "teaching, in a simulation without noise at 100 Hz",
    ),
    Law(
        "aicardi",
        "Aicardi, stopping",
        peers.AICARDI,
        _LIMITS_ONLY,
        f"{_AICARDI}, holding still once the goal is reached",
        "smooth steering of a unicycle from an exact pose; forwards or backwards",
    ),
    Law(
        "aicardi_endless",
        "Aicardi, never stopping",
        peers.AICARDI_ENDLESS,
        _LIMITS_ONLY,
        f"{_AICARDI}, without an end",
        "the same as the paper simulates it: what holding still is worth",
    ),
)


def _tuned(xy: float) -> ControllerConfig:
    return TUNED_CONTROLLER._replace(tolerance=GoalTolerance(xy_goal_tolerance=xy, yaw_goal_tolerance=YAW_TOLERANCE))


def _noise(share: float) -> SensorConfig:
    base = SensorConfig()
    return SensorConfig(
        eps_x_max=share * base.eps_x_max, eps_y_max=share * base.eps_y_max, eps_theta_max=share * base.eps_theta_max
    )


CHALLENGES = (
    Challenge("precise", "xy_goal_tolerance 0.03 m", _tuned(0.03)),
    Challenge("ts_005", "Ts 0.05 s", TUNED_CONTROLLER, PlantConfig(sampling_time=0.05)),
    Challenge("ts_02", "Ts 0.2 s", TUNED_CONTROLLER, PlantConfig(sampling_time=0.2)),
    Challenge("fixes_2_hz", "fixes at 2 Hz", TUNED_CONTROLLER, sensors=SensorConfig(fix_rate=2.0)),
    Challenge("noise_half", "fix noise halved, tolerance 0.05 m", _tuned(0.05), sensors=_noise(0.5), xy_tolerance=0.05),
    Challenge("noise_double", "fix noise doubled, tolerance 0.2 m", _tuned(0.2), sensors=_noise(2.0), xy_tolerance=0.2),
    Challenge("calibrating", "filter ekf_calibrating, the default", TUNED_CONTROLLER, filter=CALIBRATING),
    Challenge(
        "radius_error",
        "the same, one wheel's radius 2 % too large",
        TUNED_CONTROLLER,
        PlantConfig(right_radius_error=0.02),
        filter=CALIBRATING,
    ),
    Challenge(
        "wheels_limited",
        "wheel speeds limited to v_max",
        TUNED_CONTROLLER,
        PlantConfig(actuators=ActuatorConfig(wheel_speed_max=V_MAX / 0.05)),
    ),
)
DELAYED = Challenge("fix_delay", "fixes 100 ms late", TUNED_CONTROLLER, sensors=SensorConfig(fix_delay=0.1))


def arena_starts() -> Array:
    """Return the starts of the paper's simulations B (8 points, two headings) and A, (17, 3) [m, m, rad]."""
    return np.concatenate([*(starts_of("b", heading).poses for heading in HEADINGS_B), starts_of("a").poses])


def case_of(one: Law | Challenge, goal: Pose = GOAL) -> Case:
    """Return what all runs of a law or challenge share; laws are compared in the default case."""
    if isinstance(one, Law):
        shared = Configuration(controller=one.controller, filter=FilterConfig(filter=EKF))
        return make_case(shared, DURATION, goal=goal, tolerance=(XY_TOLERANCE, YAW_TOLERANCE), peer=one.peer)
    harder = Configuration(one.plant, one.sensors, one.controller, FilterConfig(filter=one.filter))
    return make_case(harder, DURATION, goal=goal, tolerance=(one.xy_tolerance, YAW_TOLERANCE))
