"""Description of a campaign: read from YAML and flags, checked, and expanded into cells."""

from __future__ import annotations

import functools
import hashlib
import itertools
import json
import math
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from diffbot_control.filter.options import FilterConfig
from diffbot_control.goals.registry import resolve_law
from diffbot_control.law.configuration import AUTO, TANH, ControllerConfig
from diffbot_control.law.controller import SwitchingLaw
from diffbot_control.law.finish import FinishConfig
from diffbot_control.law.lyapunov_law import Gains
from diffbot_control.law.paper.reapproach import ReapproachConfig
from diffbot_control.law.presets import TUNED
from diffbot_control.law.regions import COVARIANCE, FixedRegionPolicy
from diffbot_control.law.speed_profile import ProfileGains
from diffbot_core.bounded_yaml import load_yaml
from diffbot_core.code_hash import hash_of_code, hash_of_values
from diffbot_core.errors import DiffbotError, InvalidValueError, known_name
from diffbot_core.foreign_files import read_text, shown
from diffbot_core.geometry import Pose
from diffbot_core.parameter_files import MAX_BYTES
from diffbot_core.ranges import LENGTH, POSITION
from diffbot_core.schema import build, parameters_of, to_dict
from diffbot_lab.campaign.options import CampaignOptions, is_coordinate, is_number, triple
from diffbot_lab.cases import Configuration, configure, make_case
from diffbot_sim.compiled.batch import Starts, check_case
from diffbot_sim.compiled.closed_loop import Case
from diffbot_sim.compiled.jit import LIBRARIES, PACKAGES, law_version
from diffbot_sim.model.plant import PlantConfig
from diffbot_sim.model.sensors import SensorConfig

_MAX_CELLS = 10_000
_LISTS = ("start", "grid", "set")


@functools.cache
def code_version() -> str:
    """Return the hash that names the code of a campaign's results: what runs, from where, and how it is counted."""
    return hash_of_code((*PACKAGES, "diffbot_tools", "diffbot_lab"), LIBRARIES)


class Cell(NamedTuple):
    """One point of the grid."""

    values: dict[str, Any]
    """the grid's parameters at this point"""
    case: Case
    law: str
    """as in the options, for the resolved identity"""


class Campaign(NamedTuple):
    """A checked campaign."""

    options: CampaignOptions
    starts: Starts
    cells: list[Cell]
    description: dict[str, Any]
    """values of YAML and flags, for the record"""

    @property
    def identity(self) -> str:
        """Hash of the description, without the chunk size, which does not affect the results."""
        decisive = {name: value for name, value in self.description.items() if name != "chunk"}
        return hashlib.sha256(json.dumps(decisive, sort_keys=True).encode()).hexdigest()[:16]

    @property
    def heading(self) -> str:
        """What runs, in one line: law, preset, feedback, and all that is not the default."""
        given, options = self.description["set"], self.options
        law = options.law
        if law == SwitchingLaw.name and "preset" not in self.description["grid"]:
            law += f", preset {given.get('preset', TUNED)}"
        changed = [f"{name} = {value}" for name, value in given.items() if name != "preset"]
        text = f"law {law}; feedback {options.feedback}; {options.duration:g} s; seed {options.seed}; not the default: "
        return text + (", ".join(changed) or "nothing")

    @property
    def resolved(self) -> str:
        """Hash of what the description resolves to with all defaults and presets: options, starts and every case."""
        return hash_of_values([self.options._replace(chunk=0), self.starts, *self.cells])


def read_campaign(path: Path | None, flags: Mapping[str, Any]) -> Campaign:
    """Make a campaign from a YAML file and flags, which take precedence.

    Raises:
        DiffbotError: in one line: a file that cannot be read, an unknown key, a value that is not allowed.
    """
    content: Any = {}
    if path is not None:
        content = load_yaml(read_text(path, MAX_BYTES), shown(path), unique_keys=True)
    if not isinstance(content, dict):
        raise DiffbotError(f"{path}: must be a mapping of keys, found {type(content).__name__}")
    merged = {**content, **flags}
    for part in ("grid", "set"):
        merged[part] = {**_mapping(part, content.get(part)), **_mapping(part, flags.get(part))}
    return make_campaign(merged)


def make_campaign(content: Mapping[str, Any]) -> Campaign:
    """Check a campaign's description and expand its grid.

    Raises:
        InvalidValueError: naming the key, its value and the bound.
    """
    known = [*CampaignOptions._fields, *_LISTS]
    for key in content:
        if key not in known:
            raise InvalidValueError("key", key, known_name(str(key), known))
    options = build(CampaignOptions, {key: value for key, value in content.items() if key not in _LISTS})
    starts = _starts(content.get("start", {"list": [[-2.0, -5.5, math.radians(30.0)]]}))
    fixed, grid = _mapping("set", content.get("set")), _mapping("grid", content.get("grid"))
    for name, values in grid.items():
        if not isinstance(values, list) or not values:
            raise InvalidValueError(f"grid.{name}", values, "a list with at least one value")
        numbers = [value for value in values if is_number(value)]
        if len(set(numbers)) < len(numbers):
            raise InvalidValueError(f"grid.{name}", values, "values that differ")
        if name in fixed:
            raise InvalidValueError(f"set.{name}", fixed[name], "in set or in grid, not in both")
    cells = _cells(options, fixed, grid)
    for cell in cells:
        check_case(cell.case, starts)
    description = {**to_dict(options), "start": content.get("start"), "set": fixed, "grid": grid}
    description["goal"] = list(options.goal)
    return Campaign(options, starts, cells, description)


def _cells(options: CampaignOptions, fixed: Mapping[str, Any], grid: Mapping[str, list[Any]]) -> list[Cell]:
    number = math.prod(len(values) for values in grid.values())
    if number > _MAX_CELLS:
        raise InvalidValueError("grid", f"{number} cells", f"<= {_MAX_CELLS} cells")
    law = resolve_law(options.law)
    law_name = f"{options.law} {law_version(law)}"
    cells: list[Cell] = []
    unread: dict[str, str] = {}
    for values in itertools.product(*grid.values()):
        point = dict(zip(grid, values, strict=True))
        config = configure({**fixed, **point}, law)
        found = {
            one.name: choice for group, choice in _unread(config, options.feedback) for one in parameters_of(group)
        }
        unread = {name: choice for name, choice in found.items() if not cells or name in unread}
        case = make_case(config, options.duration, feedback=options.feedback, goal=Pose(*options.goal))
        cells.append(Cell(point, case, law_name))
    of_plant = {one.name for one in parameters_of(PlantConfig)}
    for part, given in (("set", fixed), ("grid", grid)):
        for name, value in given.items():
            if name in unread and name not in of_plant:
                raise InvalidValueError(f"{part}.{name}", value, f"left out, it acts only with {unread[name]}")
    return cells


def _unread(config: Configuration, feedback: str) -> Iterator[tuple[type[Any], str]]:
    """Yield the groups of parameters that the runs of a case do not read, and the choice with which they would."""
    controller = config.controller
    if isinstance(controller, ControllerConfig):
        if controller.profile == TANH:
            yield ProfileGains, "speed_profile: braking (preset tuned)"
            yield FinishConfig, "speed_profile: braking (preset tuned)"
        else:
            yield Gains, "speed_profile: tanh (preset paper)"
            yield ReapproachConfig, "speed_profile: tanh (preset paper)"
            if controller.gain_source == AUTO:
                yield ProfileGains, "gains: preset"
        if controller.region_policy.kind == COVARIANCE:
            yield FixedRegionPolicy, "region_policy: fixed (preset paper)"
    if feedback != "ekf":
        yield FilterConfig, "feedback: ekf"
    if feedback == "truth":
        yield SensorConfig, "feedback: ekf or raw"


def _starts(start: Any) -> Starts:
    """Read one of ``{list: [[x, y, theta], ...]}``, ``{box: {x: [low, high], ...}}``, ``{circle: {...}}``."""
    if not isinstance(start, dict) or len(start) != 1 or next(iter(start)) not in ("list", "box", "circle"):
        raise InvalidValueError("start", start, "one of list, box, circle with its values")
    kind, value = next(iter(start.items()))
    if kind == "list":
        if not isinstance(value, list) or not value:
            raise InvalidValueError("start.list", value, "a list with at least one [x, y, heading]")
        return Starts(np.array([triple("start.list", row) for row in value]))
    if kind == "box":
        keys = ("x", "y", "heading")
        value = _only("start.box", value, keys)
        low, high = np.array([_interval(f"start.box.{key}", value.get(key, [0.0, 0.0])) for key in keys]).T
        half = (0.5 * (high - low)).tolist()
        return Starts(np.array([0.5 * (low + high)]), (half[0], half[1], half[2]))
    value = _only("start.circle", value, ("radius", "points", "headings"))
    radius, points = value.get("radius"), value.get("points", 8)
    headings = value.get("headings", [0.0])
    if not is_number(radius) or not LENGTH[0] <= radius <= LENGTH[1]:
        raise InvalidValueError("start.circle.radius", radius, f">= {LENGTH[0]:g} and <= {LENGTH[1]:g}")
    if not isinstance(points, int) or isinstance(points, bool) or not 1 <= points <= 100_000:
        raise InvalidValueError("start.circle.points", points, "a whole number from 1 to 100000")
    if not isinstance(headings, list) or not headings or not all(map(is_coordinate, headings)):
        raise InvalidValueError("start.circle.headings", headings, f"a list of numbers [rad] within +-{POSITION[1]:g}")
    angles = [2.0 * math.pi * index / points for index in range(points)]
    return Starts(np.array([(radius * math.cos(a), radius * math.sin(a), h) for h in headings for a in angles]))


def _mapping(name: str, value: Any) -> dict[str, Any]:
    if value is None:
        return {}
    if not isinstance(value, dict) or not all(isinstance(key, str) for key in value):
        raise InvalidValueError(name, value, "a mapping from parameter names")
    return value


def _only(name: str, value: Any, keys: tuple[str, ...]) -> Any:
    if not isinstance(value, dict):
        raise InvalidValueError(name, value, "a mapping of " + ", ".join(keys))
    for key in value:
        if key not in keys:
            raise InvalidValueError(f"{name} key", key, "one of " + ", ".join(keys))
    return value


def _interval(name: str, value: Any) -> tuple[float, float]:
    if not isinstance(value, (list, tuple)) or len(value) != 2 or not all(map(is_coordinate, value)):
        raise InvalidValueError(name, value, f"two numbers [low, high] within +-{POSITION[1]:g}")
    if value[0] > value[1]:
        raise InvalidValueError(name, value, "[low, high] with low <= high")
    return float(value[0]), float(value[1])
