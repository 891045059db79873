"""Read and write YAML of plain values, and read ROS parameter files without ROS."""

from __future__ import annotations

import itertools
import re
from collections import Counter
from collections.abc import Iterable
from difflib import SequenceMatcher
from pathlib import Path
from typing import Any, NamedTuple

import yaml

from diffbot_core.errors import DiffbotError, InvalidValueError, shown
from diffbot_core.files import read_text

MAX_BYTES = 256 * 1024
"""Largest size of a parameter file; the file of a robot has 5 kB."""
PARAMETERS = "ros__parameters"
WILDCARDS = {"*": r"/\w+", "**": r"(/\w+)*"}
"""Regular expressions of the wildcards in section names."""
_NEARLY = 0.8
"""Smallest ratio of SequenceMatcher at which a name counts as a misspelling of another name."""
_MAX_NAMED = 5
"""Largest number of sections that an error names."""
_DUMPER = getattr(yaml, "CSafeDumper", yaml.SafeDumper)
_LOADER: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)


class _UniqueKeys(_LOADER):  # type: ignore[misc]
    """Loader that refuses a repeated key in a map; YAML would use the last value."""

    def construct_mapping(self, node: Any, deep: bool = False) -> dict[Any, Any]:
        counts = Counter(key.value for key, _ in node.value if isinstance(key, yaml.ScalarNode))
        if twice := next((key for key, count in counts.items() if count > 1), ""):
            raise yaml.YAMLError(f"the key {shown(twice)!r} occurs twice in one map")
        return dict(super().construct_mapping(node, deep))


def load_yaml(text: str, name: str, *, unique_keys: bool = False) -> Any:
    """Return the content of a YAML document of plain values.

    Args:
        text: the document.
        name: name of the document for error messages.
        unique_keys: refuse repeated keys in a map, for documents that are written by hand.

    Raises:
        DiffbotError: if the document is not valid YAML of plain values.
    """
    try:
        return yaml.load(text, _UniqueKeys if unique_keys else _LOADER)
    except (yaml.YAMLError, ValueError, TypeError, OverflowError, AttributeError, RecursionError) as error:
        # PyYAML's constructors raise most of these, for example for the date 2001-99-99.
        raise DiffbotError(f"{name} is not a YAML file: {shown(' '.join(str(error).split()))}") from error


def dump_yaml(content: Any) -> str:
    """Return plain values as YAML, in their order."""
    return str(yaml.dump(content, Dumper=_DUMPER, sort_keys=False))


class Section(NamedTuple):
    """The parameters of one node, or of all nodes that match a pattern."""

    name: str
    """full name of the node, such as ``/robot1/ekf``; ``*`` is any word, ``**`` any number of words"""
    values: dict[str, Any]
    """by parameter name, with dots"""

    @property
    def node(self) -> str:
        """Name of the node without its namespace, or a wildcard."""
        return self.name.rpartition("/")[2]

    def is_for(self, node: str) -> bool:
        """Return True if rcl applies the section to a node, given by its full name."""
        words = self.name.split("/")[1:]
        return re.fullmatch("".join(WILDCARDS.get(word, "/" + re.escape(word)) for word in words), node) is not None

    def is_nearly_for(self, node: str) -> bool:
        """Return True if the name of the section may be a misspelling of ``node``.

        Names that extend the name of the node, such as ``controller_1`` and ``dock_controller``, belong to other nodes,
        and so does ``controller`` for the node ``dock_controller``.
        """
        name = node.rpartition("/")[2]
        if self.node in (name, *WILDCARDS) or self.node.startswith(f"{name}_"):
            return False
        if self.node.endswith(f"_{name}") or name.endswith(f"_{self.node}"):
            return False
        return sorted(self.node) == sorted(name) or SequenceMatcher(None, self.node, name).ratio() >= _NEARLY


def read_sections(path: Path) -> list[Section]:
    """Return the sections of a parameter file in their order. If a parameter occurs twice, the last value counts.

    Raises:
        DiffbotError: if the file cannot be read or is not a parameter file.
    """
    try:
        content = load_yaml(read_text(path, MAX_BYTES), shown(path), unique_keys=True)
    except DiffbotError as error:
        raise DiffbotError(f"parameter file: {error}") from error
    if not isinstance(content, dict):
        raise DiffbotError(f"{shown(path)} is not a parameter file: it has no sections with {PARAMETERS}")
    return list(_sections(content, ""))


def _sections(content: dict[Any, Any], above: str) -> Iterable[Section]:
    for key, entry in content.items():
        name = f"{above}/{str(key).strip('/')}"
        if not isinstance(entry, dict):
            continue
        if isinstance(parameters := entry.get(PARAMETERS), dict):
            yield Section(name, _flat(parameters))
        yield from _sections({one: inner for one, inner in entry.items() if one != PARAMETERS}, name)


def _flat(parameters: dict[Any, Any], prefix: str = "") -> dict[str, Any]:
    """Join the names of nested parameters with dots."""
    values: dict[str, Any] = {}
    for name, value in parameters.items():
        values |= _flat(value, f"{prefix}{name}.") if isinstance(value, dict) else {f"{prefix}{name}": value}
    return values


def values_for(path: Path, node: str) -> dict[str, Any]:
    """Return the parameters of a node, given by its name without namespace, from sections of any namespace.

    Raises:
        DiffbotError: if the file cannot be read or has no section for the node.
    """
    sections = read_sections(path)
    refuse_misspelt(path, sections, node)
    found = [one for one in sections if one.node in (node, *WILDCARDS)]
    if not found:
        raise DiffbotError(f"{shown(path)} has no section /**/{node} with {PARAMETERS}")
    return {name: value for one in found for name, value in one.values.items()}


def refuse_misspelt(path: Path, sections: Iterable[Section], node: str) -> None:
    """Raise DiffbotError if a file has no section for a node, but a section whose name may be a misspelling."""
    name = node.rpartition("/")[2]
    sections = list(sections)
    nearly = [one for one in sections if one.is_nearly_for(node)]
    if nearly and all(one.node != name for one in sections):
        raise DiffbotError(f"{shown(path)}: section {shown(nearly[0].name)}: did you mean {name}?")


class ParameterFiles:
    """The parameter files of a process; checks that its nodes use them."""

    def __init__(self, ros_arguments: Iterable[str]) -> None:
        """Read the files that follow ``--params-file``.

        Raises:
            DiffbotError: if a file is missing or is not a parameter file.
        """
        self._given: list[tuple[Path, list[Section]]] = []
        self._used: set[Path] = set()
        self._nodes: list[str] = []
        self._given_singly: set[str] = set()
        """names of the parameters that are given by ``-p``"""
        for flag, value in itertools.pairwise(ros_arguments):
            if flag == "--params-file":
                self._given.append((Path(value), read_sections(Path(value))))
            elif flag in ("-p", "--param"):
                self._given_singly.add(value.partition(":=")[0].rpartition(":")[2])

    def add_node(self, node: str) -> None:
        """Add a node, given by its full name, that uses the files.

        Raises:
            DiffbotError: if the name of a section may be a misspelling of the node's name.
        """
        self._nodes.append(node)
        for path, sections in self._given:
            refuse_misspelt(path, sections, node)
            if any(one.is_for(node) for one in sections):
                self._used.add(path)

    def check_all_used(self) -> None:
        """Raise DiffbotError if a file has no section for any of the nodes."""
        for path, sections in self._given:
            if path not in self._used:
                names = [shown(one.name) for one in sections[:_MAX_NAMED]] + ["..."] * (len(sections) > _MAX_NAMED)
                others = f", only for {', '.join(names)}" if names else ""
                raise DiffbotError(f"{shown(path)} has no section for {' or '.join(self._nodes)}{others}")

    def error_text(self, error: Exception, node: str = "") -> str:
        """Return the text of an error with the name of the node and, for a parameter, the file that sets it.

        ``node`` is the full name of the node; by default, it is the node that was added last.
        """
        name = node or (self._nodes[-1] if self._nodes else "")
        source = self._source(name, error.name) if name and isinstance(error, InvalidValueError) else ""
        return (f"{name}: " if name else "") + f"{error}" + (f" ({source})" if source else "")

    def _source(self, node: str, parameter: str) -> str:
        """Return the file and the section that set a parameter of a node; empty if none does."""
        if parameter not in self._given_singly:
            for path, sections in reversed(self._given):
                for one in reversed(sections):
                    if parameter in one.values and one.is_for(node):
                        return f"{shown(path)}, section {shown(one.name)}"
        return ""
