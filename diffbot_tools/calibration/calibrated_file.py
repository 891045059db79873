"""The parameter file of a calibration: the given file with the values that were found; all else stays."""

from __future__ import annotations

import io
import math
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import yaml
from ruamel.yaml import YAML
from ruamel.yaml.comments import CommentedMap, CommentedSeq
from ruamel.yaml.error import YAMLError

from diffbot_control.ros.parameters.ekf import EkfNodeConfig
from diffbot_core.errors import DiffbotError
from diffbot_core.foreign_files import read_text, shown
from diffbot_core.parameter_files import MAX_BYTES, PARAMETERS, WILDCARDS
from diffbot_core.schema import to_dict
from diffbot_tools.calibration.latency import Latency, limits_of
from diffbot_tools.calibration.parameters import Outcome
from diffbot_tools.refilter.parameters import NODE

CONTROLLER = "controller"
_MARK = "calibrated"
_MARKED = re.compile(rf"(; |# ?){_MARK}\b.*")
"""note of an earlier calibration behind a value"""
_HEAD = re.compile(r"# Calibrated from .* by diffbot calibrate\.\n")
_SAME = 5e-4
"""relative difference of two values that the four digits of a calibration cannot tell apart"""
_WIDTH = 2**20
"""characters of a line: none is broken"""


class _Section(NamedTuple):
    """The parameters of one node, or of all that a pattern stands for, in the file."""

    node: str
    """last word of the section's name"""
    maps: tuple[CommentedMap, ...]
    """the outermost first; the last one has the parameters"""


class _Place(NamedTuple):
    """Where the file has a value."""

    maps: tuple[CommentedMap, ...]
    """that hold it, the outermost first"""
    key: str

    @property
    def values(self) -> CommentedMap:
        """The innermost map."""
        return self.maps[-1]


def calibrated_file(
    path: Path, config: EkfNodeConfig, outcome: Outcome, latency: Latency | None, head: str = ""
) -> str:
    """Return the text of a parameter file with the values that were found.

    A value is replaced where the file has it, in the section that counts for its node, with a note behind it. A value
    that the file does not have is put at the beginning of the section of its node. Comments, order and all other values
    stay. A limit of acceleration is only lowered: the file may have a lower one than the base on purpose.

    Args:
        path: of the given parameter file.
        config: of the ekf, from that file.
        outcome: of the calibration.
        latency: of the commands; None if it was not determined.
        head: becomes the first line, a comment.

    Raises:
        DiffbotError: in one line, if the file cannot be read.
    """
    text = read_text(path, MAX_BYTES)
    editor = YAML()
    editor.preserve_quotes = True
    editor.width = _WIDTH
    indented = re.search(r"^( +)[^\s#-]", text, re.MULTILINE)
    editor.map_indent = len(indented[1]) if indented else None
    try:
        content = editor.load(text)
    except YAMLError as error:
        raise DiffbotError(f"{shown(path)} is not a YAML file: {shown(' '.join(str(error).split()))}") from error
    given = to_dict(config)
    notes = {
        row.name: ", ".join(filter(None, (row.deviation and f"+- {row.deviation}", row.note))) for row in outcome.rows
    }
    # Of new values, the first one comes first.
    for name, value in reversed(outcome.parameters.items()):
        if not _is_same(value, given[name]):
            _put(content, NODE, name, value, notes.get(name, ""))
    if latency is not None:
        for name, limit in limits_of(latency).items():
            place = _find(content, CONTROLLER, name)
            before = math.inf if place is None else place.values[place.key]
            if not isinstance(before, (int, float)) or limit < before:
                _put(content, CONTROLLER, name, float(f"{limit:.3g}"))
        _put(content, CONTROLLER, "drive_time_constant", round(latency.time_constant, 3))
        _put(content, CONTROLLER, "command_latency", round(latency.dead_time, 3), f"+- {latency.sigma:.2g}")
    stream = io.StringIO()
    editor.dump(content, stream)
    return (f"# {head}\n" if head else "") + _HEAD.sub("", stream.getvalue(), count=1)


def _is_same(value: Any, given: Any) -> bool:
    if isinstance(value, list):
        return len(value) == len(given) and all(map(_is_same, value, given))
    if isinstance(value, float) and isinstance(given, (int, float)):
        return math.isclose(value, given, rel_tol=_SAME)
    return bool(value == given)


def _put(content: CommentedMap, node: str, name: str, value: Any, note: str = "") -> None:
    """Replace a value of a node where the file has it, or add it."""
    # From PyYAML's text, which it reads as a number, too: not so of 1e-05.
    new = YAML().load(yaml.safe_dump({name: value}, default_flow_style=True))[name]
    place, before = _find(content, node, name), ""
    if place is None:
        section = next((one for one in _sections(content) if one.node == node), None) or _add_section(content, node)
        place = _Place(section.maps, name)
        place.values.insert(0, name, new)
    else:
        old = place.values[place.key]
        before = f"{list(old) if isinstance(old, CommentedSeq) else old} before"
        if isinstance(old, CommentedSeq) and isinstance(new, CommentedSeq):
            old[:] = new  # keeps its style, and the comments behind it
        else:
            place.values[place.key] = new
    for one in place.maps:
        one.fa.set_block_style()  # a comment ends a line
    _write_note(place, ", ".join(filter(None, (_MARK, note, before))))


def _write_note(place: _Place, note: str) -> None:
    """Write a note behind a value, after the comment that is there."""
    tokens = place.values.ca.items.get(place.key)
    if tokens is None or tokens[2] is None:
        place.values.yaml_add_eol_comment(note, place.key)
        return
    # The token holds the lines up to the next value, too.
    line, newline, rest = tokens[2].value.partition("\n")
    line = _MARKED.sub("", line).rstrip()
    tokens[2].value = (f"{line}; {note}" if line else f"# {note}") + newline + rest


def _add_section(content: CommentedMap, node: str) -> _Section:
    outer, parameters = CommentedMap(), CommentedMap()
    outer[PARAMETERS] = parameters
    content[f"/**/{node}"] = outer
    return _Section(node, (content, outer, parameters))


def _find(content: CommentedMap, node: str, name: str) -> _Place | None:
    """Return the place of the value that counts for a node: the last one; None if the file does not have it."""
    found = None
    for section in _sections(content):
        if section.node in (node, *WILDCARDS):
            for place, full_name in _places(section.maps):
                found = place if full_name == name else found
    return found


def _sections(content: CommentedMap, above: tuple[CommentedMap, ...] = ()) -> Iterator[_Section]:
    """Yield the sections in the order of :func:`diffbot_core.parameter_files.read_sections`."""
    above = (*above, content)
    for name, entry in content.items():
        if not isinstance(entry, CommentedMap) or (name == PARAMETERS and len(above) > 1):
            continue
        if isinstance(parameters := entry.get(PARAMETERS), CommentedMap):
            yield _Section(str(name).strip("/").rpartition("/")[2], (*above, entry, parameters))
        yield from _sections(entry, above)


def _places(maps: tuple[CommentedMap, ...], prefix: str = "") -> Iterator[tuple[_Place, str]]:
    """Yield the place of each value and its name: ROS joins the names of nested maps with dots."""
    for key, value in maps[-1].items():
        if isinstance(value, CommentedMap):
            yield from _places((*maps, value), f"{prefix}{key}.")
        else:
            yield _Place(maps, key), f"{prefix}{key}"
