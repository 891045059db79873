"""The laws in the arena: what each is, which parameters are tuned and in which ranges."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

from diffbot_control.goals.registry import resolve_law
from diffbot_control.law.presets import PAPER, PAPER_COVARIANCE, PRESETS
from diffbot_core.schema import build, parameters_of, to_dict
from diffbot_lab.arena.cases import LIMITS, NONE, ArenaCase, Values

Space = Mapping[str, tuple[float, float]]
"""Ranges of the parameters that are tuned."""
OWN_NAME = "switching"
"""This project's law with its default preset."""


class Entry(NamedTuple):
    """One law of the arena."""

    name: str
    label: str
    law: str
    """as for :func:`resolve_law`"""
    source: str
    purpose: str
    values: Values = NONE
    """parameters that are not the law's defaults"""
    space: Space = NONE
    """empty: the parameters are as published"""
    feedback: str = "ekf"
    everywhere: bool = True
    """in all cases; otherwise in the nominal one"""


_STOP: Space = {"stop_distance": (0.005, 0.09), "stop_angle": (0.01, 0.09)}
_TURNING: Space = {"turn_brake": (2.0, 20.0), "turn_time": (0.12, 1.0)}
_DRIVE: Space = {
    "drive_brake": (1.0, 8.0),
    "drive_time": (0.2, 1.2),
    "start_angle": (0.02, 0.5),
    "line_gain": (0.5, 5.0),
}
_GRACEFUL: Space = {
    **_STOP,
    **_TURNING,
    "k_phi": (0.1, 6.0),
    "k_delta": (0.5, 6.0),
    "beta": (0.0, 1.0),
    "lambda": (1.0, 3.0),
    "slowdown_radius": (0.3, 2.0),
    "v_linear_min": (0.01, 0.2),
    "initial_rotation_tolerance": (0.05, 3.2),
}
_NAV2: Space = {
    **_STOP,
    "max_lookahead": (0.3, 3.0),
    "k_phi": (0.1, 6.0),
    "k_delta": (0.5, 6.0),
    "beta": (0.0, 1.0),
    "lambda": (1.0, 3.0),
    "slowdown_radius": (0.3, 2.0),
    "v_linear_min": (0.01, 0.2),
    "initial_rotation_tolerance": (0.05, 3.2),
    "v_angular_min_in_place": (0.0, 0.5),
    "rotation_scaling_factor": (0.2, 3.0),
}
_PARK = "J. J. Park, B. Kuipers, ICRA 2011, with the finish of nav2_graceful_controller"
_SHIPPED = "nav2_graceful_controller, Jazzy, held to its compiled code"
_TRUTH = {"drive_brake": 20.0, "drive_time": 0.12, "turn_brake": 20.0, "turn_time": 0.12, "stop_distance": 0.01}
ENTRIES = (
    Entry(
        OWN_NAME,
        "switching law",
        OWN_NAME,
        "law (17) of the paper, with braking profiles",
        "go-to-pose in open space with a noisy estimate; forwards or backwards",
    ),
    Entry(
        "rotate_drive_rotate",
        "rotate, drive, rotate",
        "rotate_drive_rotate",
        "common practice; here with braking profiles",
        "open space; the shortest way for most starts",
        space={**_STOP, **_TURNING, **_DRIVE},
    ),
    Entry(
        "rotate_drive_rotate_slow",
        "the same with a slow finish",
        "rotate_drive_rotate",
        "the same, the last decimetres slowly",
        "the same with a better final position",
        {"slow_distance": 0.2, "slow_slope": 0.8},
        {**_STOP, **_TURNING, **_DRIVE, "slow_distance": (0.05, 0.6), "slow_slope": (0.2, 2.0)},
    ),
    Entry(
        "graceful",
        "graceful, final rotation",
        "graceful",
        f"{_PARK}, prefer_final_rotation",
        "following a planned path; here straight to the goal, then a rotation in place",
        space=_GRACEFUL,
    ),
    Entry(
        "graceful_pose",
        "graceful, to the pose",
        "graceful",
        f"{_PARK}, straight to the goal's pose",
        "comfortable motion of a wheelchair along a smooth curve to a pose",
        {"prefer_final_rotation": False},
        _GRACEFUL,
    ),
    Entry(
        "nav2_graceful",
        "Nav2's graceful controller",
        "nav2_graceful",
        f"{_SHIPPED}; the speeds of the case, forwards, no look ahead over latencies",
        "following a planned path among obstacles; here straight to the goal, planned anew each second",
        {"v_linear_max": 1.3, "v_angular_max": 2.6},
        _NAV2,
    ),
    Entry(
        "feedback_linearisation",
        "dynamic feedback linearisation, Omega_L",
        "feedback_linearisation",
        "G. Oriolo, A. De Luca, M. Vendittelli, IEEE Trans. Control Systems Technology 10 (2002)",
        "tracking and posture regulation from an exact pose",
        space={
            **_TURNING,
            "k_p": (0.1, 4.0),
            "damping": (1.02, 2.5),
            "along_max": (0.5, 8.0),
            "region_sigmas": (0.3, 4.0),
            "region_min": (0.01, 0.1),
            "near_slope": (0.5, 3.0),
        },
    ),
    Entry(
        "pure_pursuit",
        "regulated pure pursuit, rotation shim",
        "pure_pursuit",
        "S. Macenski et al., Autonomous Robots 47 (2023); Nav2's rotation shim",
        "following a planned path; here the straight line",
        space={
            **_STOP,
            **_TURNING,
            "lookahead_time": (0.1, 2.0),
            "min_lookahead_dist": (0.2, 1.0),
            "approach_velocity_scaling_dist": (0.2, 1.5),
            "min_approach_linear_velocity": (0.02, 0.3),
            "regulated_linear_scaling_min_radius": (0.1, 1.0),
            "angular_dist_threshold": (0.05, 1.0),
        },
    ),
    Entry(
        "truth",
        "bound: rotate, drive, rotate on the true pose",
        "rotate_drive_rotate",
        "the same law without an estimate",
        "a bound, no peer: the true pose is not known to a robot",
        _TRUTH,
        {**_STOP, **_TURNING, **_DRIVE},
        feedback="truth",
    ),
    Entry(
        "switching_paper_covariance",
        "switching law, paper's gains",
        OWN_NAME,
        "law (17) with the paper's gains, radius from the covariance",
        "what the gains alone change",
        to_dict(PRESETS[PAPER_COVARIANCE]),
        everywhere=False,
    ),
    Entry(
        "switching_paper",
        "switching law, paper's",
        OWN_NAME,
        "law (17) with the paper's gains and a fixed radius of 0.5 m",
        "the paper's law as published; made for a heading, not for a position within 0.1 m",
        to_dict(PRESETS[PAPER]),
        everywhere=False,
    ),
    Entry(
        "nav2_graceful_shipped",
        "Nav2's graceful controller, defaults",
        "nav2_graceful",
        f"{_SHIPPED}; its defaults: 0.5 m/s and 1 rad/s; goal checker 0.06 m and 0.05 rad",
        "following a planned path indoors",
        everywhere=False,
    ),
    Entry(
        "aicardi_endless",
        "Aicardi, never stopping",
        "aicardi",
        "M. Aicardi et al., IEEE Robotics and Automation Magazine 2 (1995); "
        "law (13) of the paper, its gains, without an end",
        "as the paper simulates it: what holding still is worth",
        {"stop_distance": 0.0, "stop_angle": 0.0},
        everywhere=False,
    ),
)


def is_own(entry: Entry) -> bool:
    """Return True for this project's law, with any parameters."""
    return entry.law == OWN_NAME


def entries_for(places: tuple[str, ...]) -> tuple[Entry, ...]:
    """Return this project's law and those of ``places``: names of entries or ``package.module:Class``; all for none.

    Raises:
        InvalidValueError: if a law is not found.
    """
    if not places:
        return ENTRIES
    known = {one.name: one for one in ENTRIES}
    return (known[OWN_NAME], *(known.get(place) or _foreign(place) for place in places if place != OWN_NAME))


def _foreign(place: str) -> Entry:
    law = resolve_law(place)
    space = getattr(law, "search_space", NONE)
    return Entry(law.name, law.name, place, place, "brought along", NONE, space)


def config_of(entry: Entry, case: ArenaCase, tuned: Values) -> Any:
    """Return the configuration of a law in a case: its values, what was tuned, and the data sheet.

    Args:
        entry: the law.
        case: its data sheet is passed on by the names of the parameters; a law gets those that it has.
        tuned: values that replace the entry's.
    """
    law = resolve_law(entry.law)
    names = {one.name for one in parameters_of(law.Config)}
    sheet = {name: value for name, value in {**LIMITS, **case.sheet}.items() if name in names}
    own = case.own if entry.name == OWN_NAME else {}
    return build(law.Config, {**entry.values, **tuned, **own, **sheet})
