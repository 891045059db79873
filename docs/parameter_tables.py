"""Write the lists of parameters on the pages in docs/reference/parameters/.

The rest of a page is written by hand. Each list is in a block, which names the nodes and the parameters to show:
``<!--parameters NODE NODE: NAME finish_*-->`` ... ``<!--/parameters-->``. If a block names several nodes, the
parameters must be the same in all of them.
"""

from __future__ import annotations

import math
import re
from fnmatch import fnmatchcase
from typing import Any, NamedTuple

from diffbot_bag.parameters import RecorderConfig, ReplayConfig
from diffbot_control.law.configuration import DockingConfig, PaperConfig
from diffbot_control.law.registry import PAPER, TUNED
from diffbot_control.ros.parameters.controller import CONTROLLER_PRESETS, ControllerNodeConfig
from diffbot_control.ros.parameters.dock import DockDetection
from diffbot_control.ros.parameters.ekf import EkfNodeConfig
from diffbot_core.schema import Parameter, parameters_of, to_dict, variant
from diffbot_sim.parameters import PlantNodeConfig

NODES = {
    "controller": ControllerNodeConfig,
    "ekf": EkfNodeConfig,
    "dock_ekf": DockDetection,
    "plant": PlantNodeConfig,
    "docking": variant(DockingConfig, {}, without=("drive",)),
    "paper": variant(PaperConfig, {}, without=("data_sheet", "tolerance", "allow_backward")),
    "recorder": RecorderConfig,
    "replay": ReplayConfig,
}
TECHNICAL_MAXIMUM = 10.0
"""An upper bound of at least this value, or of pi rad, only catches mistakes, so the range is not shown."""
PAIRS = (("x", "y"), ("left", "right"))
"""Neighbouring parameters whose texts differ in one of these words share an entry."""
_BLOCK = re.compile(r"(<!--parameters ([\w ]+): ([^>]+)-->\n).*?(<!--/parameters-->)", re.DOTALL)


class Entry(NamedTuple):
    """One paragraph of a list: one parameter, or a pair of x and y, or of left and right."""

    names: tuple[str, ...]
    default: str
    """default value with its unit; only the unit in brackets if the default is an empty text or list"""
    limits: str
    """range, default of the preset paper, and ``fixed`` for a parameter that cannot be changed"""
    text: str

    def paragraph(self) -> str:
        """Return the Markdown of the entry."""
        names = ", ".join(f"**`{name}`**" for name in self.names)
        notes = f"({self.limits})" if self.limits else ""
        return " ".join(filter(None, (names, self.default, notes))) + f": {self.text}"


def with_parameters(page: str) -> str:
    """Return a page with current lists in its blocks.

    Raises:
        ValueError: if a pattern of a block does not match a parameter, or a parameter differs between nodes.
    """
    return _BLOCK.sub(lambda block: f"{block[1]}\n{_list(block[2].split(), block[3].split())}\n{block[4]}", page)


def shown(page: str) -> list[tuple[str, str]]:
    """Return node and name of each parameter that the blocks of a page show."""
    return [
        (node, one.name)
        for _, nodes, patterns, _ in _BLOCK.findall(page)
        for node in nodes.split()
        for one in _selected(node, patterns.split())
    ]


def _selected(node: str, patterns: list[str]) -> list[Parameter]:
    found = []
    for text in patterns:
        named = [one for one in parameters_of(NODES[node]) if fnmatchcase(one.name, text)]
        if not named:
            raise ValueError(f"{node} has no parameter {text}")
        found += named
    return found


def _list(nodes: list[str], patterns: list[str]) -> str:
    entries = _entries(nodes[0], patterns)
    for node in nodes[1:]:
        if different := set(entries) ^ set(_entries(node, patterns)):
            raise ValueError(f"{nodes[0]} and {node} differ in {sorted({one.names[0] for one in different})}")
    return "\n\n".join(one.paragraph() for one in _merged(entries))


def _entries(node: str, patterns: list[str]) -> list[Entry]:
    tuned, paper = (to_dict(CONTROLLER_PRESETS[name]) if node == "controller" else {} for name in (TUNED, PAPER))
    all_fixed = all(one.spec.read_only for one in parameters_of(NODES[node]))
    return [_entry(one, tuned, paper, not all_fixed) for one in _selected(node, patterns)]


def _entry(parameter: Parameter, tuned: dict[str, Any], paper: dict[str, Any], mark_fixed: bool) -> Entry:
    name, spec = parameter.name, parameter.spec
    default, unit = _text(tuned.get(name, parameter.default)), spec.unit
    if unit not in ("", "-"):
        default += f" {unit}" if default else f"[{unit}]"
    notes = [_range(parameter)]
    if name in paper and tuned.get(name) != paper[name]:
        notes.append(f"paper: {_text(paper[name])}")
    if mark_fixed and spec.read_only:
        notes.append("fixed")
    text = spec.text.replace("*", "\\*").replace("<", "&lt;")
    return Entry((name,), default, "; ".join(filter(None, notes)), text)


def _merged(entries: list[Entry]) -> list[Entry]:
    """Return the entries, with one entry for neighbours that differ only in name and in a word of PAIRS."""
    found: list[Entry] = []
    for entry in entries:
        if found and (text := _common_text(found[-1], entry)):
            found[-1] = found[-1]._replace(names=found[-1].names + entry.names, text=text)
        else:
            found.append(entry)
    return found


def _common_text(first: Entry, second: Entry) -> str:
    """Return the text for both entries, such as ``x/y of the dock``; empty if they differ in more than a word."""
    for one, other in PAIRS:
        text = re.sub(rf"\b{one}\b", f"{one}/{other}", first.text, count=1)
        if second[1:] == first._replace(text=re.sub(rf"\b{one}\b", other, first.text, count=1))[1:]:
            return text
    return ""


def _range(parameter: Parameter) -> str:
    """Return the allowed values in one word: ``0..5`` or ``tuned|paper``."""
    spec = parameter.spec
    if spec.choices:
        return "|".join(spec.choices)
    if parameter.type not in (float, int) or spec.maximum >= (math.pi if spec.unit == "rad" else TECHNICAL_MAXIMUM):
        return ""
    return "" if (spec.minimum, spec.maximum, spec.unit) == (0.0, 1.0, "-") else f"{spec.minimum:g}..{spec.maximum:g}"


def _text(value: Any) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if not value and isinstance(value, (str, tuple)):
        return ""
    return f"{value:.6g}" if isinstance(value, float) else str(value)
