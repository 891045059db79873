"""The lists of parameters on the pages in docs/reference/parameters/.

A page is written by hand, except for its lists. Each list stands in a block that names the node and the parameters to
show, in their order: ``<!-- parameters NODE: NAME finish_* -->`` ... ``<!-- /parameters -->``.
"""

from __future__ import annotations

import re
from fnmatch import fnmatchcase
from typing import Any

from diffbot_bag.parameters import RecorderConfig, ReplayConfig
from diffbot_control.law.docking_axis import DockingConfig
from diffbot_control.law.presets import PAPER, TUNED
from diffbot_control.ros.parameters.controller import CONTROLLER_PRESETS, ControllerNodeConfig
from diffbot_control.ros.parameters.ekf import EkfNodeConfig
from diffbot_core.schema import Parameter, parameters_of, to_dict, variant
from diffbot_sim.ros.parameters import PlantNodeConfig

NODES = {
    "controller": ControllerNodeConfig,
    "ekf": EkfNodeConfig,
    "plant": PlantNodeConfig,
    "docking": variant(DockingConfig, {}, without=("drive",)),
    "recorder": RecorderConfig,
    "replay": ReplayConfig,
}
_BLOCK = re.compile(r"(<!-- parameters (\w+): ([^>]+) -->\n).*?(<!-- /parameters -->)", re.DOTALL)


def with_parameters(page: str) -> str:
    """Return a page with current lists in its blocks.

    Raises:
        ValueError: a pattern of a block matches no parameter of its node.
    """
    return _BLOCK.sub(lambda block: f"{block[1]}\n{_list(block[2], block[3].split())}\n{block[4]}", page)


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


def _list(node: str, patterns: list[str]) -> str:
    tuned, paper = (to_dict(CONTROLLER_PRESETS[name]) if node == "controller" else {} for name in (TUNED, PAPER))
    all_fixed = all(one.spec.read_only for one in parameters_of(NODES[node]))
    return "\n\n".join(_entry(one, tuned, paper, not all_fixed) for one in _selected(node, patterns))


def _entry(parameter: Parameter, tuned: dict[str, Any], paper: dict[str, Any], mark_fixed: bool) -> str:
    """Return one paragraph: name, default with unit, and in parentheses the range and what else limits the value."""
    name, spec = parameter.name, parameter.spec
    default, unit = _text(tuned.get(name, parameter.default)), spec.unit
    if unit not in ("", "-"):
        default += f" [{unit}]" if default == "empty" else f" {unit}"
    notes = [_range(parameter)]
    if tuned.get(name) != paper.get(name):
        notes.append(f"paper: {_text(paper[name])}")
    if mark_fixed and spec.read_only:
        notes.append("fixed")
    limits = "; ".join(filter(None, notes))
    text = spec.text.replace("*", "\\*").replace("<", "&lt;")
    return f"**`{name}`** {default}{f' ({limits})' if limits else ''}: {text}"


def _range(parameter: Parameter) -> str:
    """Return the allowed values in one word: ``0..60``, ``0..10|inf`` or ``tuned|paper``."""
    spec = parameter.spec
    if spec.choices:
        return "|".join(spec.choices)
    if parameter.type not in (float, int):
        return ""
    return f"{spec.minimum:g}..{spec.maximum:g}" + ("|inf" if spec.allow_inf else "")


def _text(value: Any) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if not value and isinstance(value, (str, tuple)):
        return "empty"
    return f"{value:.6g}" if isinstance(value, float) else str(value)
