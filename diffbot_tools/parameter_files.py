"""YAML files of plain values, and what a ROS parameter file says about one node, without ROS."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import yaml

from diffbot_core.errors import DiffbotError


class _Loader(yaml.SafeLoader):
    """Refuses duplicate keys, of which YAML keeps the last, and aliases, which can expand beyond any memory."""

    def compose_node(self, parent: Any, index: Any) -> Any:
        if self.check_event(yaml.AliasEvent):
            raise yaml.YAMLError("aliases (*name) are not taken")
        return super().compose_node(parent, index)

    def construct_mapping(self, node: Any, deep: bool = False) -> dict[Any, Any]:
        found = set()
        for key, _ in node.value:
            if key.value in found:
                raise yaml.MarkedYAMLError(problem=f"{key.value!r} stands there twice", problem_mark=key.start_mark)
            found.add(key.value if isinstance(key, yaml.ScalarNode) else id(key))
        return super().construct_mapping(node, deep)


def load_yaml(text: str) -> Any:
    """Read one YAML document of plain values.

    Raises:
        ValueError: in one line, if it is none.
    """
    try:
        return yaml.load(text, _Loader)
    except (yaml.YAMLError, ValueError) as error:  # ValueError: a day that does not exist
        raise ValueError(" ".join(str(error).split())) from None
    except RecursionError:
        raise ValueError("nested too deep") from None


class ParameterFile(NamedTuple):
    """A parameter file as one node reads it."""

    text: str
    """of the whole file"""
    values: dict[str, Any]
    """of the node's parameters, by their names with dots"""
    has_node: bool
    """there is an entry for the node"""


def read_parameters(path: Path, node: str) -> ParameterFile:
    """Return the parameters of each entry whose last part is ``node`` or ``**``, as ``/**/ekf``; later ones win.

    Raises:
        DiffbotError: if the file cannot be read.
    """
    try:
        text = path.read_text(encoding="utf-8")
        content = load_yaml(text)
    except OSError as error:
        raise DiffbotError(f"cannot read {path}: {error.strerror}") from error
    except ValueError as error:
        raise DiffbotError(f"{path} is not a parameter file: {error}") from error
    values: dict[str, Any] = {}
    found = False
    for name, entry in content.items() if isinstance(content, dict) else ():
        parameters = entry.get("ros__parameters") if isinstance(entry, dict) else None
        if str(name).rsplit("/", 1)[-1] in (node, "**") and isinstance(parameters, dict):
            found = True
            values |= _flat(parameters)
    return ParameterFile(text, values, found)


def _flat(parameters: dict[Any, Any], prefix: str = "") -> dict[str, Any]:
    """Join the names of nested parameters with dots, as ROS does."""
    values: dict[str, Any] = {}
    for name, value in parameters.items():
        values |= _flat(value, f"{prefix}{name}.") if isinstance(value, dict) else {f"{prefix}{name}": value}
    return values
