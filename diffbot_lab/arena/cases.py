"""Cases of the arena: what the robot, its sensors and its data sheet are, and where runs start."""

from __future__ import annotations

import math
from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, NamedTuple, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from diffbot_control.filter.options import CALIBRATING, EKF, FilterConfig
from diffbot_control.law.presets import PRECISE, PRESETS, TUNED
from diffbot_core.errors import InvalidValueError
from diffbot_core.schema import build, parameters_of, to_dict
from diffbot_lab.paper.scenarios import HEADINGS_B, starts_of
from diffbot_sim.model.plant import PlantConfig
from diffbot_sim.model.sensors import SensorConfig

Array = NDArray[np.float64]
Values = Mapping[str, Any]

NONE: Values = MappingProxyType({})
DURATION = 60.0
"""[s] of a run"""
XY_TOLERANCE, YAW_TOLERANCE = 0.1, 0.1
"""[m], [rad] within which a run has to end"""
WHEEL_RADIUS = 0.05
"""[m]"""
LIMITS: Values = {"linear.x.max_velocity": 1.3, "angular.z.max_velocity": 2.6, "wheel.max_velocity": 1.3 / WHEEL_RADIUS}
"""Data sheet of every case: 1.3 m/s at the rims, 2.6 rad/s."""
ARENA, TRAINING, FAR, NEAR, DOCKING, SHORT = "arena", "training", "far", "near", "docking", "short"
SPEED, ACCELERATION, OWN = "speed", "acceleration", "own"
"""Tables: bounded speeds; bounded accelerations, too; this project's law alone."""
_DISTANCES = {NEAR: (0.0, 1.0), SHORT: (0.05, 0.7)}
"""[m] from the goal of random starts, where it is not the usual"""


class ArenaCase(NamedTuple):
    """One case, by the names of the parameters that differ from the defaults."""

    name: str
    text: str
    table: str = SPEED
    world: Values = NONE
    """of plant and sensors"""
    sheet: Values = NONE
    """of the data sheet, known to every law"""
    starts: str = ARENA
    filter: str = EKF
    own: Values = NONE
    """of this project's law alone"""
    xy_tolerance: float = XY_TOLERANCE


_PRECISE = {name: value for name, value in to_dict(PRESETS[PRECISE]).items() if value != to_dict(PRESETS[TUNED])[name]}
_RIM_DEAD_BAND = 0.03
"""[m/s]"""
_STICTION = {"dead_band": _RIM_DEAD_BAND / WHEEL_RADIUS, "breakaway": _RIM_DEAD_BAND / WHEEL_RADIUS}
_MIN_COMMANDS = {"min_velocity": 0.032, "min_rotation": 0.11}
_ACCELERATION = {"acceleration_max": 0.5, "angular_acceleration_max": 1.5}
_KNOWN_ACCELERATION = {"linear.x.max_acceleration": 0.5, "angular.z.max_acceleration": 1.5}
_LATE = {"fix_rate": 5.0, "fix_delay": 0.15}
_MIX = {
    **_ACCELERATION,
    **_STICTION,
    **_LATE,
    "command_delay": 0.1,
    "drive_time_constant": 0.1,
    "left_radius_error": 0.02,
    "separation_error": 0.03,
}
_KNOWN_MIX = {
    **_KNOWN_ACCELERATION,
    **_MIN_COMMANDS,
    "command_latency": 0.1,
    "drive_time_constant": 0.1,
    "angular.z.max_velocity": 1.5,
}


def _dead_time(seconds: float, known: bool, table: str = SPEED) -> ArenaCase:
    name = f"dead_time_{round(10 * seconds):02d}" + ("" if known else "_unknown")
    text = f"dead time {seconds:g} s, {'known' if known else 'not known to the laws'}"
    return ArenaCase(name, text, table, {"command_delay": seconds}, {"command_latency": seconds} if known else {})


def _lag(seconds: float) -> ArenaCase:
    values = {"drive_time_constant": seconds}
    return ArenaCase(
        f"lag_{round(100 * seconds):03d}", f"lag of the drives {seconds:g} s, known", SPEED, values, values
    )


def _noise(share: float) -> Values:
    base = SensorConfig()
    return {name: share * getattr(base, name) for name in ("eps_x_max", "eps_y_max", "eps_theta_max")}


CASES = (
    ArenaCase("nominal", "bounded speeds, nothing added"),
    *(_dead_time(seconds, known=True) for seconds in (0.1, 0.2, 0.3)),
    _dead_time(0.2, known=False),
    _lag(0.15),
    _lag(0.3),
    ArenaCase("dead_band", "dead band with stiction, 0.03 m/s at the rims, known", SPEED, _STICTION, _MIN_COMMANDS),
    ArenaCase(
        "slip",
        "5 % half-normal slip of each wheel, filter ekf_calibrating",
        world={"slip_noise": 0.05},
        filter=CALIBRATING,
    ),
    ArenaCase("separation", "distance of the wheels 3 % larger than known", world={"separation_error": 0.03}),
    ArenaCase("coloured_05", "coloured fixes, correlation 0.5", world={"fix_noise_correlation": 0.5}),
    ArenaCase("coloured_09", "coloured fixes, correlation 0.9", world={"fix_noise_correlation": 0.9}),
    ArenaCase("late_fixes", "fixes at 5 Hz, 0.15 s late", world=_LATE),
    ArenaCase("random_far", "starts 0.2 to 15 m away, any heading", starts=FAR),
    ArenaCase("random_near", "starts within 1 m, any heading", starts=NEAR),
    ArenaCase("docking", "starts 0.5 to 3 m before the goal, up to 0.3 m beside its axis", starts=DOCKING),
    ArenaCase("acceleration", "0.5 m/s^2 and 1.5 rad/s^2, known", ACCELERATION, _ACCELERATION, _KNOWN_ACCELERATION),
    ArenaCase(
        "acceleration_dead_time",
        "the same with a dead time of 0.3 s, known",
        ACCELERATION,
        {**_ACCELERATION, "command_delay": 0.3},
        {**_KNOWN_ACCELERATION, "command_latency": 0.3},
    ),
    ArenaCase(
        "acceleration_near", "starts within 1 m, any heading", ACCELERATION, _ACCELERATION, _KNOWN_ACCELERATION, NEAR
    ),
    ArenaCase("acceleration_docking", "docking starts", ACCELERATION, _ACCELERATION, _KNOWN_ACCELERATION, DOCKING),
    ArenaCase("mix", "realistic mix, data sheet known", ACCELERATION, _MIX, _KNOWN_MIX, filter=CALIBRATING),
    ArenaCase("random_mix", "realistic mix, starts 0.2 to 15 m away", ACCELERATION, _MIX, _KNOWN_MIX, FAR, CALIBRATING),
    ArenaCase(
        "forward_mix",
        "the same, forwards only",
        OWN,
        _MIX,
        _KNOWN_MIX,
        FAR,
        CALIBRATING,
        {"allow_backward": False},
    ),
    ArenaCase("short_mix", "realistic mix, starts 0.05 to 0.7 m away", OWN, _MIX, _KNOWN_MIX, SHORT, CALIBRATING),
    ArenaCase(
        "position_fixes",
        "fixes at 5 Hz whose heading says nothing",
        OWN,
        {"fix_rate": 5.0, "eps_theta_max": math.pi},
    ),
    ArenaCase(
        "coloured_09_wide",
        "coloured fixes, correlation 0.9, tolerance 0.15 m",
        OWN,
        {"fix_noise_correlation": 0.9},
        own={"xy_goal_tolerance": 0.15},
        xy_tolerance=0.15,
    ),
    ArenaCase("precise", "preset precise: xy_goal_tolerance 0.03 m", OWN, own=_PRECISE, xy_tolerance=0.03),
    ArenaCase("ts_005", "Ts 0.05 s", OWN, {"sampling_time": 0.05}),
    ArenaCase("ts_02", "Ts 0.2 s", OWN, {"sampling_time": 0.2}),
    ArenaCase("fixes_2_hz", "fixes at 2 Hz", OWN, {"fix_rate": 2.0}),
    ArenaCase(
        "noise_half",
        "fix noise halved, tolerance 0.05 m",
        OWN,
        _noise(0.5),
        own={"xy_goal_tolerance": 0.05},
        xy_tolerance=0.05,
    ),
    ArenaCase(
        "noise_double",
        "fix noise doubled, tolerance 0.2 m",
        OWN,
        _noise(2.0),
        own={"xy_goal_tolerance": 0.2},
        xy_tolerance=0.2,
    ),
    ArenaCase("calibrating", "filter ekf_calibrating, the default", OWN, filter=CALIBRATING),
    ArenaCase(
        "radius_error",
        "the same, one wheel's radius 2 % too large",
        OWN,
        {"right_radius_error": 0.02},
        filter=CALIBRATING,
    ),
)


class _Named(Protocol):
    @property
    def name(self) -> str: ...


_Case = TypeVar("_Case", bound=_Named)


def cases_of(cases: tuple[_Case, ...], names: tuple[str, ...]) -> tuple[_Case, ...]:
    """Return those of ``cases`` that have these names, all for none.

    Raises:
        InvalidValueError: for an unknown name.
    """
    known = {one.name: one for one in cases}
    for name in names:
        if name not in known:
            raise InvalidValueError("case", name, "one of " + ", ".join(known))
    return tuple(known[name] for name in names) or cases


def cases_named(names: tuple[str, ...]) -> tuple[ArenaCase, ...]:
    """Return the cases of the arena of these names, see :func:`cases_of`."""
    return cases_of(CASES, names)


def world_of(case: ArenaCase) -> tuple[PlantConfig, SensorConfig, FilterConfig]:
    """Return plant, sensors and filter of a case; the plant's wheels reach what the data sheet allows.

    Raises:
        InvalidValueError: for a value that neither plant nor sensors have.
    """
    values = {"wheel_speed_max": LIMITS["wheel.max_velocity"], **case.world}
    plant = {one.name for one in parameters_of(PlantConfig)}
    of_plant = {name: value for name, value in values.items() if name in plant}
    of_sensors = {name: value for name, value in values.items() if name not in plant}
    return build(PlantConfig, of_plant), build(SensorConfig, of_sensors), FilterConfig(filter=case.filter)


def arena_starts() -> Array:
    """Return the starts of the paper's simulations B (8 points, two headings) and A, (17, 3) [m, m, rad]."""
    return np.concatenate([*(starts_of("b", heading).poses for heading in HEADINGS_B), starts_of("a").poses])


def starts_named(kind: str, count: int, seed: int) -> Array:
    """Return ``count`` starting poses of a kind, (count, 3) [m, m, rad]; the goal is at the origin, heading along x.

    Random ones follow from ``seed`` and the kind; distances are uniform.
    """
    if kind == ARENA:
        poses: Array = np.resize(arena_starts(), (count, 3))
        return poses
    rng = np.random.default_rng((seed, (TRAINING, FAR, NEAR, DOCKING, SHORT).index(kind)))
    if kind == DOCKING:
        low, high = (-3.0, -0.3, -0.4), (-0.5, 0.3, 0.4)
        return rng.uniform(low, high, (count, 3))
    distance = rng.uniform(*_DISTANCES.get(kind, (0.2, 15.0)), count)
    bearing, heading = rng.uniform(-math.pi, math.pi, (2, count))
    return np.column_stack((distance * np.cos(bearing), distance * np.sin(bearing), heading))
