"""The laws of the benchmark, the ranges of their tuned parameters, and their tuned values."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

from diffbot_control.law.law import Law
from diffbot_control.law.registry import resolve_law
from diffbot_core.errors import DiffbotError, InvalidValueError
from diffbot_core.schema import build, parameters_of
from diffbot_lab.benchmark.cases import LIMITS, NONE, OWN, BenchmarkCase, Values

Space = Mapping[str, tuple[float, float]]
"""Range (low, high) of each tuned parameter."""
OWN_NAME = "switching"
"""Name of this project's law. It is not tuned: it has its default preset."""
TUNING = Path(__file__).with_name("tuning.json")
"""Result of ``diffbot benchmark tune`` that is installed with the package."""


class BenchmarkLaw(NamedTuple):
    """One law of the benchmark."""

    name: str
    label: str
    source: str
    space: Space = NONE
    """ranges of the tuned parameters; empty if the law is not tuned"""
    values: Values = NONE
    """parameters that differ from the law's defaults"""
    place: str = ""
    """argument of :func:`resolve_law`: name or ``package.module:Class``; empty if the law is registered as ``name``"""

    @property
    def law(self) -> type[Law]:
        """Class of the law."""
        return resolve_law(self.place or self.name)


_STOP: Space = {"stop_distance": (0.005, 0.09), "stop_angle": (0.01, 0.09)}
_TURNING: Space = {"turn_brake": (2.0, 20.0), "turn_time": (0.12, 1.0)}
_DRIVE: Space = {
    **_STOP,
    **_TURNING,
    "drive_brake": (1.0, 8.0),
    "drive_time": (0.2, 1.2),
    "start_angle": (0.02, 0.5),
    "line_gain": (0.5, 5.0),
}
_PARK_GAINS: Space = {
    "k_phi": (0.1, 6.0),
    "k_delta": (0.5, 6.0),
    "beta": (0.0, 1.0),
    "lambda": (1.0, 3.0),
    "slowdown_radius": (0.3, 2.0),
    "v_linear_min": (0.01, 0.2),
    "initial_rotation_tolerance": (0.05, 3.2),
}
_GRACEFUL: Space = {**_STOP, **_TURNING, **_PARK_GAINS}
_NAV2: Space = {
    **_STOP,
    "max_lookahead": (0.3, 3.0),
    **_PARK_GAINS,
    "v_angular_min_in_place": (0.0, 0.5),
    "rotation_scaling_factor": (0.2, 3.0),
}
_LINEARISATION: Space = {
    **_TURNING,
    "k_p": (0.1, 4.0),
    "damping": (1.02, 2.5),
    "along_max": (0.5, 8.0),
    "region_sigmas": (0.3, 4.0),
    "region_min": (0.01, 0.1),
    "near_slope": (0.5, 3.0),
}
_PURSUIT: Space = {
    **_STOP,
    **_TURNING,
    "lookahead_time": (0.1, 2.0),
    "min_lookahead_dist": (0.2, 1.0),
    "approach_velocity_scaling_dist": (0.2, 1.5),
    "min_approach_linear_velocity": (0.02, 0.3),
    "regulated_linear_scaling_min_radius": (0.1, 1.0),
    "angular_dist_threshold": (0.05, 1.0),
}
_PARK = "J. J. Park, B. Kuipers, ICRA 2011, with the finish of nav2_graceful_controller"
_NAV2_SOURCE = "nav2_graceful_controller, Jazzy, equal to its compiled code; a new plan every second, no prediction"
_SLOW: Values = {"slow_distance": 0.2, "slow_slope": 0.8}
_SLOW_DRIVE: Space = {**_DRIVE, "slow_distance": (0.05, 0.6), "slow_slope": (0.2, 2.0)}
_ORIOLO = "G. Oriolo, A. De Luca, M. Vendittelli, IEEE Trans. Control Systems Technology 10 (2002)"
_MACENSKI = "S. Macenski et al., Autonomous Robots 47 (2023); Nav2's rotation shim"
_RDR, _AT_SPEED = "rotate_drive_rotate", {"v_linear_max": 1.3, "v_angular_max": 2.6}
_TO_POSE: Values = {"prefer_final_rotation": False}
ENTRIES = (
    BenchmarkLaw(OWN_NAME, "switching law", "law (17) of the paper, with braking profiles"),
    BenchmarkLaw(_RDR, "rotate, drive, rotate", "common practice; here with braking profiles", _DRIVE),
    BenchmarkLaw(f"{_RDR}_slow", "the same with a slow finish", "the last decimetres slowly", _SLOW_DRIVE, _SLOW, _RDR),
    BenchmarkLaw("graceful", "graceful, final rotation", f"{_PARK}, prefer_final_rotation", _GRACEFUL),
    BenchmarkLaw(
        "graceful_pose", "graceful, to the pose", f"{_PARK}, straight to the pose", _GRACEFUL, _TO_POSE, "graceful"
    ),
    BenchmarkLaw("nav2_graceful", "Nav2's graceful controller", _NAV2_SOURCE, _NAV2, _AT_SPEED),
    BenchmarkLaw("feedback_linearisation", "dynamic feedback linearisation, Omega_L", _ORIOLO, _LINEARISATION),
    BenchmarkLaw("pure_pursuit", "regulated pure pursuit, rotation shim", _MACENSKI, _PURSUIT),
)


def entries_for(places: tuple[str, ...]) -> tuple[BenchmarkLaw, ...]:
    """Return this project's law and the laws of ``places``; without places, return all entries.

    A place is the name of an entry, or an argument of :func:`resolve_law`.

    Raises:
        InvalidValueError: if a law is not found, or has the name of another law.
    """
    if not places:
        return ENTRIES
    known = {entry.name: entry for entry in ENTRIES}
    chosen = {OWN_NAME: known[OWN_NAME]}
    for place in places:
        entry = known.get(place) or _other_law(place)
        if chosen.setdefault(entry.name, entry) != entry:
            raise InvalidValueError("law", place, sentence=f"another law of the comparison is called {entry.name}, too")
    return tuple(chosen.values())


def _other_law(place: str) -> BenchmarkLaw:
    law = resolve_law(place)
    return BenchmarkLaw(law.name, law.name, place, law.search_space, place=place)


def is_run(entry: BenchmarkLaw, case: BenchmarkCase) -> bool:
    """Return True if the law drives in this case."""
    return case.table != OWN or entry.name == OWN_NAME


def config_of(entry: BenchmarkLaw, case: BenchmarkCase, tuned: Values) -> Any:
    """Return the configuration of a law in a case.

    Args:
        entry: the law.
        case: the case. Parameters of its data sheet that the law does not have are ignored.
        tuned: tuned values, which replace the values of the entry.
    """
    names = {one.name for one in parameters_of(entry.law.Config)}
    sheet = {name: value for name, value in {**LIMITS, **case.sheet}.items() if name in names}
    own = case.own if entry.name == OWN_NAME else {}
    return build(entry.law.Config, {**entry.values, **tuned, **own, **sheet})


def read_tuning(path: Path) -> dict[str, Any]:
    """Return the content of a tuning.json.

    Raises:
        DiffbotError: if the file cannot be read, or was not written by ``diffbot benchmark tune``.
    """
    try:
        content: dict[str, Any] = json.loads(path.read_text())
    except OSError as error:
        raise DiffbotError(f"cannot read {path}: {error.strerror}") from None
    except (ValueError, RecursionError):
        raise DiffbotError(f"{path} is not JSON") from None
    laws = content.get("laws") if isinstance(content, dict) else None
    if not isinstance(laws, dict) or not all(isinstance(one, dict) and "values" in one for one in laws.values()):
        raise DiffbotError(f"{path} is not a result of diffbot benchmark tune")
    return content


def tuned_values(tuning: dict[str, Any], entry: BenchmarkLaw) -> dict[str, Any]:
    """Return the tuned values of a law; empty if the law was not tuned.

    Raises:
        InvalidValueError: for a parameter that is not tuned for this law.
    """
    values = tuning["laws"].get(entry.name, {"values": {}})["values"]
    for name in values:
        if name not in entry.space:
            raise InvalidValueError(f"tuning of {entry.name}", name, "one of " + (", ".join(entry.space) or "none"))
    return dict(values)
