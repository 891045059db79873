"""Cases of the benchmark: the robot, its sensors, its data sheet, and where the runs start."""

from __future__ import annotations

import math
from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from diffbot_control.filter.config import CALIBRATING, EKF, FilterConfig
from diffbot_control.law.registry import PRECISE, PRESETS, TUNED
from diffbot_core.errors import InvalidValueError
from diffbot_core.schema import build, parameters_of, to_dict
from diffbot_lab.paper.experiment import HEADINGS_B, starts_of
from diffbot_sim.config import PlantConfig, SensorConfig

Array = NDArray[np.float64]
Values = Mapping[str, Any]

NONE: Values = MappingProxyType({})
DURATION = 60.0
"""[s] duration of a run"""
XY_TOLERANCE, YAW_TOLERANCE = 0.1, 0.1
"""[m], [rad] largest errors of position and heading of a settled run"""
WHEEL_RADIUS = 0.05
"""[m]"""
LIMITS: Values = {"linear.x.max_velocity": 1.3, "angular.z.max_velocity": 2.6, "wheel.max_velocity": 1.3 / WHEEL_RADIUS}
"""Limits of every case: 1.3 m/s for the robot and for the rims of the wheels, 2.6 rad/s."""
ARENA, TRAINING, FAR, NEAR, DOCKING, SHORT = "arena", "training", "far", "near", "docking", "short"
"""Kinds of starts. ARENA are the 17 starts of the paper; the other kinds are random."""
SPEED, ACCELERATION, OWN = "speed", "acceleration", "own"
"""Tables of the results: limited speeds; limited speeds and accelerations; cases of this project's law only."""
_DISTANCES = {NEAR: (0.0, 1.0), SHORT: (0.05, 0.7)}
"""[m] range of the distances of random starts from the goal; TRAINING and FAR have 0.2 to 15 m"""


class BenchmarkCase(NamedTuple):
    """One case. The mappings contain only parameters that differ from the defaults."""

    name: str
    text: str
    table: str = SPEED
    world: Values = NONE
    """parameters of plant and sensors"""
    sheet: Values = NONE
    """parameters of the data sheet, which every law receives"""
    starts: str = ARENA
    filter: str = EKF
    own: Values = NONE
    """parameters of this project's law"""
    xy_tolerance: float = XY_TOLERANCE


_PRECISE = dict(set(to_dict(PRESETS[PRECISE].config).items()) - set(to_dict(PRESETS[TUNED].config).items()))
_LATENCY: Values = {"command_latency": 0.3}
_LAG: Values = {"drive_time_constant": 0.3}
_DEAD_BAND: Values = {"dead_band": 0.03 / WHEEL_RADIUS}
_MIN_COMMANDS: Values = {"min_velocity": 0.032, "min_rotation": 0.11}
_ACCELERATION: Values = {"linear.x.max_acceleration": 0.5, "angular.z.max_acceleration": 1.5}
_LATE: Values = {"fix_rate": 5.0, "fix_delay": 0.15}
_SLOW: Values = {**_ACCELERATION, "command_latency": 0.1, "drive_time_constant": 0.1}
_MIX: Values = {**_SLOW, **_DEAD_BAND, **_LATE, "left_radius_error": 0.02, "separation_error": 0.03}
_KNOWN_MIX: Values = {**_SLOW, **_MIN_COMMANDS, "angular.z.max_velocity": 1.5}
_WIDE: Values = {"xy_goal_tolerance": 0.15}
CASES = (
    BenchmarkCase("nominal", "bounded speeds, nothing added"),
    BenchmarkCase("dead_time_03", "dead time 0.3 s, known", SPEED, _LATENCY, _LATENCY),
    BenchmarkCase("dead_time_02_unknown", "dead time 0.2 s, not known to the laws", world={"command_latency": 0.2}),
    BenchmarkCase("lag_030", "lag of the drives 0.3 s, known", SPEED, _LAG, _LAG),
    BenchmarkCase(
        "dead_band", "dead band with stiction, 0.03 m/s at the rims, known", SPEED, _DEAD_BAND, _MIN_COMMANDS
    ),
    BenchmarkCase(
        "slip",
        "5 % half-normal slip of each wheel, filter ekf_calibrating",
        world={"slip_noise": 0.05},
        filter=CALIBRATING,
    ),
    BenchmarkCase("separation", "distance of the wheels 3 % larger than known", world={"separation_error": 0.03}),
    BenchmarkCase("coloured_05", "coloured fixes, correlation 0.5", world={"fix_noise_correlation": 0.5}),
    BenchmarkCase("coloured_09", "coloured fixes, correlation 0.9", world={"fix_noise_correlation": 0.9}),
    BenchmarkCase("late_fixes", "fixes at 5 Hz, 0.15 s late", world=_LATE),
    BenchmarkCase("random_far", "starts 0.2 to 15 m away, any heading", starts=FAR),
    BenchmarkCase("random_near", "starts within 1 m, any heading", starts=NEAR),
    BenchmarkCase("docking", "starts 0.5 to 3 m before the goal, up to 0.3 m beside its axis", starts=DOCKING),
    BenchmarkCase("acceleration", "0.5 m/s^2 and 1.5 rad/s^2, known", ACCELERATION, _ACCELERATION, _ACCELERATION),
    BenchmarkCase("acceleration_docking", "docking starts", ACCELERATION, _ACCELERATION, _ACCELERATION, DOCKING),
    BenchmarkCase("mix", "realistic mix, data sheet known", ACCELERATION, _MIX, _KNOWN_MIX, ARENA, CALIBRATING),
    BenchmarkCase(
        "random_mix", "realistic mix, starts 0.2 to 15 m away", ACCELERATION, _MIX, _KNOWN_MIX, FAR, CALIBRATING
    ),
    BenchmarkCase(
        "forward_mix", "the same, forwards only", OWN, _MIX, _KNOWN_MIX, FAR, CALIBRATING, {"allow_backward": False}
    ),
    BenchmarkCase("short_mix", "realistic mix, starts 0.05 to 0.7 m away", OWN, _MIX, _KNOWN_MIX, SHORT, CALIBRATING),
    BenchmarkCase(
        "position_fixes",
        "fixes at 5 Hz whose heading says nothing",
        OWN,
        {"fix_rate": 5.0, "eps_theta_max": math.pi},
    ),
    BenchmarkCase(
        "coloured_09_wide",
        "coloured fixes, correlation 0.9, tolerance 0.15 m",
        OWN,
        {"fix_noise_correlation": 0.9},
        own=_WIDE,
        xy_tolerance=0.15,
    ),
    BenchmarkCase("precise", "preset precise: xy_goal_tolerance 0.03 m", OWN, own=_PRECISE, xy_tolerance=0.03),
    BenchmarkCase("ts_02", "Ts 0.2 s", OWN, {"sampling_time": 0.2}),
    BenchmarkCase("fixes_2_hz", "fixes at 2 Hz", OWN, {"fix_rate": 2.0}),
)


def cases_named(names: tuple[str, ...], cases: tuple[Any, ...] = CASES) -> tuple[Any, ...]:
    """Return the cases with these names; without names, return all cases.

    Raises:
        InvalidValueError: for an unknown name.
    """
    known = {case.name: case for case in cases}
    for name in names:
        if name not in known:
            raise InvalidValueError("case", name, "one of " + ", ".join(known))
    return tuple(known[name] for name in dict.fromkeys(names)) or cases


def world_of(case: BenchmarkCase) -> tuple[PlantConfig, SensorConfig, FilterConfig]:
    """Return plant, sensors and filter of a case. The plant limits the wheel speed as the data sheet does."""
    values = {"wheel_speed_max": LIMITS["wheel.max_velocity"], **case.world}
    plant = {one.name for one in parameters_of(PlantConfig)}
    of_plant = {name: value for name, value in values.items() if name in plant}
    of_sensors = {name: value for name, value in values.items() if name not in plant}
    return build(PlantConfig, of_plant), build(SensorConfig, of_sensors), FilterConfig(filter=case.filter)


def arena_starts() -> Array:
    """Return the starts (17, 3) [m, m, rad] of the paper: simulation B (8 points, 2 headings), then simulation A."""
    return np.concatenate([*(starts_of("b", heading).poses for heading in HEADINGS_B), starts_of("a").poses])


def starts_named(kind: str, count: int, seed: int) -> Array:
    """Return starts (count, 3) [m, m, rad] of a kind, for a goal at the origin with heading 0.

    Random starts depend on ``seed`` and the kind. Their distances from the goal are uniformly distributed, except for
    DOCKING.
    """
    if kind == ARENA:
        poses: Array = np.resize(arena_starts(), (count, 3))
        return poses
    rng = np.random.default_rng((seed, (TRAINING, FAR, NEAR, DOCKING, SHORT).index(kind)))
    if kind == DOCKING:
        return rng.uniform((-3.0, -0.3, -0.4), (-0.5, 0.3, 0.4), (count, 3))
    distance = rng.uniform(*_DISTANCES.get(kind, (0.2, 15.0)), count)
    bearing, heading = rng.uniform(-math.pi, math.pi, (2, count))
    return np.column_stack((distance * np.cos(bearing), distance * np.sin(bearing), heading))
