"""Parameters of the node ``ekf`` from a ROS parameter file, without ROS."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from diffbot_control.ros.ekf_parameters import EkfNodeConfig
from diffbot_core.errors import DiffbotError
from diffbot_core.schema import build
from diffbot_lab.campaign.options import load_yaml

NODE = "ekf"
IGNORED = frozenset({"use_sim_time"})
"""Parameters that every node of ROS has."""


def read_config(path: Path) -> tuple[EkfNodeConfig, str]:
    """Return the configuration of a parameter file, and the text of the file.

    Used are the parameters of each entry whose last part is ``ekf`` or ``**``, as ``/**/ekf``; later ones win.

    Raises:
        DiffbotError: if the file cannot be read, has no such entry, or a parameter is unknown or out of its bounds.
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
    for name, node in content.items() if isinstance(content, dict) else ():
        parameters = node.get("ros__parameters") if isinstance(node, dict) else None
        if str(name).rsplit("/", 1)[-1] in (NODE, "**") and isinstance(parameters, dict):
            found = True
            values |= _flat(parameters)
    if not found:
        raise DiffbotError(f"{path} has no entry /**/{NODE} with ros__parameters")
    try:
        return build(EkfNodeConfig, {name: value for name, value in values.items() if name not in IGNORED}), text
    except DiffbotError as error:
        raise DiffbotError(f"{path}: {error}") from error


def _flat(parameters: dict[Any, Any], prefix: str = "") -> dict[str, Any]:
    """Join the names of nested parameters with dots, as ROS does."""
    values: dict[str, Any] = {}
    for name, value in parameters.items():
        values |= _flat(value, f"{prefix}{name}.") if isinstance(value, dict) else {f"{prefix}{name}": value}
    return values
