"""Read the description of a campaign from YAML and flags, check it, and expand its grid into cells."""

from __future__ import annotations

import functools
import hashlib
import itertools
import json
import math
import sys
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from diffbot_control.filter.config import FilterConfig
from diffbot_control.law.registry import TUNED, resolve_law
from diffbot_control.law.switching import SwitchingLaw
from diffbot_core.errors import DiffbotError, InvalidValueError, known_name, shown
from diffbot_core.files import read_text
from diffbot_core.installed import DIGITS, hash_of_code
from diffbot_core.schema import LENGTH, POSITION, build, parameters_of, to_dict
from diffbot_core.yaml_files import MAX_BYTES, load_yaml
from diffbot_lab.campaign.options import CampaignOptions
from diffbot_lab.cases import configure, law_of, make_case
from diffbot_sim.batch import Starts, check_case
from diffbot_sim.config import PlantConfig, SensorConfig
from diffbot_sim.jit import LIBRARIES, PACKAGES, law_version
from diffbot_sim.robot_step import EKF, TRUTH, Case

_MAX_CELLS = 10_000
_SECTIONS = ("start", "grid", "set")
_STEPS_PER_CHUNK = 2_000_000
"""largest number of steps in one chunk. A chunk takes about half a second on one core, which is short enough for the
progress bar, and little is lost by an interruption"""
_RUNS_PER_CHUNK = 100_000
"""largest number of runs in one chunk, since a worker holds the outcomes of all these runs in memory"""


@functools.cache
def code_version() -> str:
    """Return the hash of the code that determines the results of a campaign."""
    return hash_of_code((*PACKAGES, "diffbot_tools", "diffbot_lab"), LIBRARIES)


def hash_of_values(values: Iterable[Any]) -> str:
    """Hash configurations, which are nested named tuples, mappings, sequences and arrays of plain values.

    Floats are hashed exactly. Type names and field names of named tuples are hashed, too.
    """
    digest = hashlib.sha256()
    for value in values:
        digest.update(json.dumps(_canonical(value), sort_keys=True).encode() + b"\n")
    return digest.hexdigest()[:DIGITS]


def _canonical(value: Any) -> Any:
    """Convert ``value`` to JSON types."""
    if isinstance(value, tuple) and hasattr(value, "_fields"):
        fields = {name: _canonical(one) for name, one in zip(value._fields, value, strict=True)}
        return {type(value).__name__: fields}
    if isinstance(value, dict):
        return {name: _canonical(one) for name, one in value.items()}
    if isinstance(value, (list, tuple)):
        return [_canonical(one) for one in value]
    return value.tolist() if hasattr(value, "tolist") else value


class Cell(NamedTuple):
    """One point of the grid."""

    values: dict[str, Any]
    """values of the grid's parameters"""
    case: Case
    law: str
    """argument of :func:`resolve_law`"""
    version: str
    """hash of the law's code"""


class Campaign(NamedTuple):
    """A campaign whose description has been checked."""

    options: CampaignOptions
    starts: Starts
    cells: list[Cell]
    description: dict[str, Any]
    """values from YAML and flags"""

    @property
    def identity(self) -> str:
        """Return a hash of all values that determine the results, including defaults and presets."""
        return hash_of_values([self.options, self.starts, *self.cells])

    @property
    def heading(self) -> str:
        """Return a line with law, preset, feedback, duration, seed, and all values that are not the default."""
        given, options = self.description["set"], self.options
        law = options.law
        if law == SwitchingLaw.name and "preset" not in self.description["grid"]:
            law += f", preset {given.get('preset', TUNED)}"
        changed = [f"{name} = {value}" for name, value in given.items() if name != "preset"]
        text = f"law {law}; feedback {options.feedback}; {options.duration:g} s; seed {options.seed}; not the default: "
        return text + (", ".join(changed) or "nothing")

    def chunks(self, cell: int) -> range:
        """Return the first run of each chunk of a cell. The ``step`` of the range is the size of a chunk."""
        size = min(max(1, _STEPS_PER_CHUNK // self.cells[cell].case.steps), _RUNS_PER_CHUNK)
        return range(0, self.options.runs, size)


def read_campaign(path: Path | None, flags: Mapping[str, Any]) -> Campaign:
    """Read a campaign from a YAML file and flags. Flags take precedence.

    Raises:
        DiffbotError: for a file that cannot be read, an unknown key, or a value that is not allowed.
    """
    content: Any = {}
    if path is not None:
        content = load_yaml(read_text(path, MAX_BYTES), shown(path), unique_keys=True)
    if not isinstance(content, dict):
        raise DiffbotError(f"{path} must contain a mapping of keys, but it contains a {type(content).__name__}")
    merged = {**content, **flags}
    for part in ("grid", "set"):
        merged[part] = {**_mapping(part, content.get(part)), **_mapping(part, flags.get(part))}
    return make_campaign(merged)


def make_campaign(content: Mapping[str, Any]) -> Campaign:
    """Check the description of a campaign and expand its grid.

    Raises:
        InvalidValueError: for an unknown key or a value that is not allowed.
    """
    known = [*CampaignOptions._fields, *_SECTIONS]
    for key in content:
        if key not in known:
            raise InvalidValueError("key", key, known_name(str(key), known))
    options = build(CampaignOptions, {key: value for key, value in content.items() if key not in _SECTIONS})
    starts = _starts(content.get("start", {"list": [[-2.0, -5.5, math.radians(30.0)]]}))
    fixed, grid = _mapping("set", content.get("set")), _mapping("grid", content.get("grid"))
    for name, values in grid.items():
        if not isinstance(values, list) or not values:
            raise InvalidValueError(f"grid.{name}", values, "a list with at least one value")
        if len({float(value) if _is_number(value) else repr(value) for value in values}) < len(values):
            raise InvalidValueError(f"grid.{name}", values, sentence="each value may be given only once")
        if name in fixed:
            raise InvalidValueError(f"set.{name}", fixed[name], sentence="it is given in set and in grid; give it once")
    cells = _cells(options, fixed, grid)
    for cell in cells:
        check_case(cell.case, starts)
    description = {**to_dict(options), "start": content.get("start"), "set": fixed, "grid": grid}
    return Campaign(options, starts, cells, description)


def _cells(options: CampaignOptions, fixed: Mapping[str, Any], grid: Mapping[str, list[Any]]) -> list[Cell]:
    number = math.prod(len(values) for values in grid.values())
    if number > _MAX_CELLS:
        raise InvalidValueError("grid", f"{number} cells", f"<= {_MAX_CELLS} cells")
    cells: list[Cell] = []
    for values in itertools.product(*grid.values()):
        point = dict(zip(grid, values, strict=True))
        name = law_of(options.law, {**fixed, **point})
        law = resolve_law(name)
        config = configure({**fixed, **point}, law)
        case = make_case(config, options.duration, law=law, feedback=options.feedback)
        cells.append(Cell(point, case, name, law_version(law)))
    ignored = _ignored_parameters(options.feedback)
    for part, given in (("set", fixed), ("grid", grid)):
        for name, value in given.items():
            if name in ignored:
                raise InvalidValueError(f"{part}.{name}", value, sentence=f"it has an effect only with {ignored[name]}")
    return cells


def _ignored_parameters(feedback: str) -> dict[str, str]:
    """Return the parameters that have no effect with this feedback, and the text of the feedback that each requires."""
    found: dict[str, str] = {}
    if feedback != EKF:
        found |= dict.fromkeys((one.name for one in parameters_of(FilterConfig)), "feedback: ekf")
    if feedback == TRUTH:
        found |= dict.fromkeys((one.name for one in parameters_of(SensorConfig)), "feedback: ekf or raw")
    of_plant = {one.name for one in parameters_of(PlantConfig)}
    return {name: choice for name, choice in found.items() if name not in of_plant}


def _starts(start: Any) -> Starts:
    """Read ``{list: [[x, y, theta], ...]}``, ``{box: {x: [low, high], ...}}`` or ``{circle: {radius: ...}}``."""
    if not isinstance(start, dict) or len(start) != 1 or next(iter(start)) not in ("list", "box", "circle"):
        raise InvalidValueError("start", start, "a mapping with exactly one key: list, box or circle")
    kind, value = next(iter(start.items()))
    if kind == "list":
        if not isinstance(value, list) or not value:
            raise InvalidValueError("start.list", value, "a list with at least one [x, y, heading]")
        bound = f"three numbers x, y, heading within +-{POSITION[1]:g}"
        return Starts(np.array([_numbers("start.list", row, 3, bound) for row in value]))
    if kind == "box":
        keys = ("x", "y", "heading")
        value = _with_keys("start.box", value, keys)
        low, high = np.array([_interval(f"start.box.{key}", value.get(key, [0.0, 0.0])) for key in keys]).T
        half = (0.5 * (high - low)).tolist()
        return Starts(np.array([0.5 * (low + high)]), (half[0], half[1], half[2]))
    value = _with_keys("start.circle", value, ("radius", "points", "headings"))
    radius, points = value.get("radius"), value.get("points", 8)
    if not _is_number(radius) or not LENGTH[0] <= radius <= LENGTH[1]:
        raise InvalidValueError("start.circle.radius", radius, f">= {LENGTH[0]:g} and <= {LENGTH[1]:g}")
    if not isinstance(points, int) or isinstance(points, bool) or not 1 <= points <= 100_000:
        raise InvalidValueError("start.circle.points", points, "a whole number from 1 to 100000")
    bound = f"a list of numbers [rad] within +-{POSITION[1]:g}"
    headings = _numbers("start.circle.headings", value.get("headings", [0.0]), None, bound)
    angles = [2.0 * math.pi * index / points for index in range(points)]
    return Starts(np.array([(radius * math.cos(a), radius * math.sin(a), h) for h in headings for a in angles]))


def _interval(name: str, value: Any) -> list[float]:
    low, high = _numbers(name, value, 2, f"two numbers [low, high] within +-{POSITION[1]:g}")
    if low > high:
        raise InvalidValueError(name, value, "[low, high] with low <= high")
    return [low, high]


def _numbers(name: str, value: Any, count: int | None, bound: str) -> list[float]:
    """Return a value from YAML as a list of ``count`` coordinates; None for any number of at least one."""
    if not isinstance(value, (list, tuple)) or not value or (count is not None and len(value) != count):
        raise InvalidValueError(name, value, bound)
    if not all(_is_number(one) and POSITION[0] <= one <= POSITION[1] for one in value):
        raise InvalidValueError(name, value, bound)
    return [float(one) for one in value]


def _is_number(value: Any) -> bool:
    """Return True if a value from YAML is a finite number."""
    # math.isfinite fails for integers that are too large for a float.
    return isinstance(value, (int, float)) and not isinstance(value, bool) and abs(value) <= sys.float_info.max


def _mapping(name: str, value: Any) -> dict[str, Any]:
    if value is None:
        return {}
    if not isinstance(value, dict) or not all(isinstance(key, str) for key in value):
        raise InvalidValueError(name, value, "a mapping of parameter names to values")
    return value


def _with_keys(name: str, value: Any, keys: tuple[str, ...]) -> Any:
    """Return a mapping from YAML that contains no other keys than ``keys``.

    Raises:
        InvalidValueError: for another key, or a value that is not a mapping.
    """
    if not isinstance(value, dict):
        raise InvalidValueError(name, value, "a mapping with the keys " + ", ".join(keys))
    for key in value:
        if key not in keys:
            raise InvalidValueError(f"{name} key", key, "one of " + ", ".join(keys))
    return value
