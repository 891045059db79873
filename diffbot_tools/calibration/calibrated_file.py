"""Write the values of a calibration into the text of the given parameter file and keep everything else."""

from __future__ import annotations

import io
import math
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import yaml
from ruamel.yaml import YAML
from ruamel.yaml.comments import CommentedMap, CommentedSeq
from ruamel.yaml.error import YAMLError

from diffbot_control.ros.parameters.ekf import EkfNodeConfig
from diffbot_core.errors import DiffbotError, shown
from diffbot_core.files import read_text
from diffbot_core.schema import DISTANCE, to_dict
from diffbot_core.yaml_files import MAX_BYTES, PARAMETERS, WILDCARDS
from diffbot_tools.calibration.latency import LatencyEstimate
from diffbot_tools.calibration.parameters import CalibrationResult
from diffbot_tools.parameter_file import EKF

_CONTROLLER, _PLANT = "controller", "plant"
_SIMULATED = {"global_pose_sigma_xy": ("eps_xy_max", DISTANCE[1]), "global_pose_sigma_yaw": ("eps_theta_max", math.pi)}
"""Parameter of the plant that sets each deviation in the simulation, and its maximum."""
_MARKED = re.compile(r"(; |# ?)calibrated\b.*")
"""note of an earlier calibration behind a value"""
_HEAD = re.compile(r"# Calibrated from .* by diffbot calibrate\.\n")
_SAME = 5e-4
"""Values with a smaller relative difference are equal, because a calibration has four digits."""
_WIDTH = 2**20
"""[characters] width of a line, large enough that no line is wrapped"""
_Maps = tuple[CommentedMap, ...]
"""A map and the maps that contain it, outermost first."""


def calibrated_file(
    path: Path, config: EkfNodeConfig, result: CalibrationResult, latency: LatencyEstimate | None, head: str
) -> str:
    """Return the text of a parameter file with the values that were found.

    A value is replaced where the file has it, in the section that counts for its node, with a note behind it. A value
    that the file does not have is inserted at the beginning of the section of its node. Comments, order and all other
    values are kept. An acceleration limit is only lowered: a file may set a lower limit than the limit of the base.
    If the file describes the global_pose of a simulated robot, its errors follow the deviations that were found.

    Args:
        path: the given parameter file.
        config: configuration of the ekf in this file.
        result: result of the calibration.
        latency: latency of the commands; None if it was not determined.
        head: text of the first line, which is a comment.

    Raises:
        DiffbotError: if the file cannot be read.
    """
    text = read_text(path, MAX_BYTES)
    editor = YAML()
    editor.preserve_quotes, editor.width = True, _WIDTH
    indented = re.search(r"^( +)[^\s#-]", text, re.MULTILINE)
    editor.map_indent = len(indented[1]) if indented else None
    try:
        content = editor.load(text)
    except YAMLError as error:
        raise DiffbotError(f"{shown(path)} is not a YAML file: {shown(' '.join(str(error).split()))}") from error
    given = to_dict(config)
    notes = {
        row.name: ", ".join(filter(None, (row.deviation and f"+- {row.deviation}", row.note))) for row in result.rows
    }
    # Each new value is inserted at the beginning of its section, so insert them in reverse order.
    for name, value in reversed(result.parameters.items()):
        if not _is_same(value, given[name]):
            _put(content, EKF, name, value, notes.get(name, ""))
            simulated, maximum = _SIMULATED.get(name, ("", 0.0))
            if simulated and _find(content, _PLANT, simulated) is not None:
                # The errors are uniformly distributed.
                _put(content, _PLANT, simulated, min(float(f"{math.sqrt(3.0) * value:.4g}"), maximum))
    if latency is not None:
        _put_latency(content, latency)
    stream = io.StringIO()
    editor.dump(content, stream)
    return f"# {head}\n" + _HEAD.sub("", stream.getvalue(), count=1)


def _put_latency(content: Any, latency: LatencyEstimate) -> None:
    """Write the limits, the time constant and the latency of the base into the section of the controller."""
    for name, limit in latency.limits().items():
        maps, key = _find(content, _CONTROLLER, name) or ((CommentedMap(),), "")
        before = maps[-1].get(key, math.inf)
        if not isinstance(before, (int, float)) or limit < before:
            _put(content, _CONTROLLER, name, float(f"{limit:.3g}"))
    _put(content, _CONTROLLER, "drive_time_constant", round(latency.time_constant, 3))
    _put(content, _CONTROLLER, "command_latency", round(latency.dead_time, 3), f"+- {latency.sigma:.2g}")


def _is_same(value: Any, given: Any) -> bool:
    if isinstance(value, list):
        return len(value) == len(given) and all(map(_is_same, value, given))
    if isinstance(value, float) and isinstance(given, (int, float)):
        return math.isclose(value, given, rel_tol=_SAME)
    return bool(value == given)


def _put(content: CommentedMap, node: str, name: str, value: Any, note: str = "") -> None:
    """Replace a value of a node where the file has it, or add it."""
    # PyYAML writes 1e-05 as 1.0e-05, which YAML parsers read as a number.
    new = YAML().load(yaml.safe_dump({name: value}, default_flow_style=True))[name]
    place, before = _find(content, node, name), ""
    if place is None:
        maps, key = next((maps for one, maps in _sections(content) if one == node), None), name
        if maps is None:
            maps = content, CommentedMap(), CommentedMap()
            content[f"/**/{node}"], maps[1][PARAMETERS] = maps[1:]
        maps[-1].insert(0, key, new)
    else:
        maps, key = place
        old = maps[-1][key]
        before = f"{list(old) if isinstance(old, CommentedSeq) else old} before"
        if isinstance(old, CommentedSeq) and isinstance(new, CommentedSeq):
            # Setting single items keeps their comments and the style of the list. The new list is never shorter.
            old.extend(new[len(old) :])
            for index, item in enumerate(new):
                old[index] = item
        else:
            maps[-1][key] = new
    for one in maps:
        one.fa.set_block_style()  # in flow style, the note would comment out the values behind it
    _write_note(maps[-1], key, ", ".join(filter(None, ("calibrated", note, before))))


def _write_note(values: CommentedMap, key: str, note: str) -> None:
    """Write a note behind a value and its comment. Replace the note of an earlier calibration."""
    tokens = values.ca.items.get(key)
    if tokens is None or tokens[2] is None:
        values.yaml_add_eol_comment(note, key)
        return
    # The token also holds the lines up to the next value.
    line, newline, rest = tokens[2].value.partition("\n")
    line = _MARKED.sub("", line).rstrip()
    tokens[2].value = (f"{line}; {note}" if line else f"# {note}") + newline + rest


def _find(content: CommentedMap, node: str, name: str) -> tuple[_Maps, str] | None:
    """Return the maps and the key of the last value that applies to a node; None if the file does not set it."""
    found = None
    for section, maps in _sections(content):
        if section in (node, *WILDCARDS):
            found = next((place for place, full_name in _values(maps) if full_name == name), found)
    return found


def _sections(content: CommentedMap, above: _Maps = ()) -> Iterator[tuple[str, _Maps]]:
    """Yield node and parameters of the sections in the order of :func:`diffbot_core.yaml_files.read_sections`."""
    above = (*above, content)
    for name, entry in content.items():
        if not isinstance(entry, CommentedMap) or (name == PARAMETERS and len(above) > 1):
            continue
        if isinstance(parameters := entry.get(PARAMETERS), CommentedMap):
            yield str(name).strip("/").rpartition("/")[2], (*above, entry, parameters)
        yield from _sections(entry, above)


def _values(maps: _Maps, prefix: str = "") -> Iterator[tuple[tuple[_Maps, str], str]]:
    """Yield the place of each value and its name: ROS joins the names of nested maps with dots."""
    for key, value in maps[-1].items():
        if isinstance(value, CommentedMap):
            yield from _values((*maps, value), f"{prefix}{key}.")
        else:
            yield (maps, key), f"{prefix}{key}"
