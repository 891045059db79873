"""The tables of parameters on the pages in docs/reference/parameters/.

A page is written by hand, except for its tables. Each stands in a block that names the node and the parameters that it
shows, in their order: ``<!-- parameters NODE: NAME finish_* -->`` ... ``<!-- /parameters -->``.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

from diffbot_bag.parameters import RecorderConfig, ReplayConfig
from diffbot_control.law.docking_axis import DockingConfig
from diffbot_control.law.presets import PAPER, TUNED
from diffbot_control.ros.parameters.controller import CONTROLLER_PRESETS, ControllerNodeConfig
from diffbot_control.ros.parameters.ekf import EkfNodeConfig
from diffbot_core.schema import Parameter, parameters_of, to_dict, variant
from diffbot_lab.targets import markdown_table
from diffbot_sim.ros.parameters import PlantNodeConfig

FOLDER = Path(__file__).parent / "reference" / "parameters"
NODES = {
    "controller": ControllerNodeConfig,
    "ekf": EkfNodeConfig,
    "plant": PlantNodeConfig,
    "docking": variant(DockingConfig, {}, without=("drive",)),
    "recorder": RecorderConfig,
    "replay": ReplayConfig,
}
_BLOCK = re.compile(r"(<!-- parameters (\w+): ([^>]+) -->\n).*?(<!-- /parameters -->)", re.DOTALL)


def pages() -> dict[Path, str]:
    """Return the text of each page with current tables."""
    return {path: with_tables(path.read_text()) for path in sorted(FOLDER.glob("*.md"))}


def with_tables(page: str) -> str:
    """Return a page with current tables in its blocks.

    Raises:
        ValueError: a pattern of a block is the name of no parameter.
    """
    return _BLOCK.sub(lambda block: f"{block[1]}{_table(block[2], block[3].split())}\n{block[4]}", page)


def shown(page: str) -> list[tuple[str, str]]:
    """Return node and name of each parameter that the blocks of a page show."""
    return [
        (node, one.name) for _, node, patterns, _ in _BLOCK.findall(page) for one in _selected(node, patterns.split())
    ]


def _selected(node: str, patterns: list[str]) -> list[Parameter]:
    found = []
    for text in patterns:
        named = [one for one in parameters_of(NODES[node]) if fnmatchcase(one.name, text)]
        if not named:
            raise ValueError(f"{node} has no parameter {text}")
        found += named
    return found


def _table(node: str, patterns: list[str]) -> str:
    tuned, paper = (to_dict(CONTROLLER_PRESETS[name]) if node == "controller" else {} for name in (TUNED, PAPER))
    all_fixed = all(one.spec.read_only for one in parameters_of(NODES[node]))
    rows = [list(_cells(one, tuned, paper, not all_fixed)) for one in _selected(node, patterns)]
    return "\n".join(markdown_table(("parameter", "default", "allowed", "meaning"), rows))


def _cells(parameter: Parameter, tuned: dict[str, Any], paper: dict[str, Any], mark_fixed: bool) -> Iterator[str]:
    name, spec = parameter.name, parameter.spec
    default = _text(tuned.get(name, parameter.default))
    if tuned.get(name) != paper.get(name):
        default += f" (paper: {_text(paper[name])})"
    if spec.unit not in ("", "-"):
        default += f" [{spec.unit}]" if default == "-" else f" {spec.unit}"
    allowed = spec.bound() if parameter.type in (float, int) or spec.choices else ""
    allowed = re.sub(r">= (\S+) and <= (\S+)", r"[\1, \2]", allowed.removeprefix("one of "))
    for cell in (f"`{name}`", default, allowed, spec.text + (" (fixed)" if mark_fixed and spec.read_only else "")):
        yield cell.replace("|", "\\|")


def _text(value: Any) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if not value and isinstance(value, (str, tuple)):
        return "-"
    return f"{value:.6g}" if isinstance(value, float) else str(value)
