"""What a ROS parameter file says about one node, without ROS."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

from diffbot_core.errors import DiffbotError
from diffbot_lab.campaign.options import load_yaml


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
