"""Parameters of the node ``ekf`` from a ROS parameter file, without ROS."""

from __future__ import annotations

from pathlib import Path

from diffbot_control.ros.parameters.ekf import EkfNodeConfig
from diffbot_core.errors import DiffbotError
from diffbot_core.foreign_files import read_text
from diffbot_core.parameter_files import MAX_BYTES, values_for
from diffbot_core.schema import build

NODE = "ekf"
IGNORED = frozenset({"use_sim_time"})
"""Parameters that every node of ROS has."""


def read_config(path: Path) -> tuple[EkfNodeConfig, str]:
    """Return the configuration of a parameter file, and the text of the file.

    Used are the parameters of each entry whose last part is ``ekf`` or ``**``, as ``/**/ekf``; later ones win.

    Raises:
        DiffbotError: if the file cannot be read, has no such entry, or a parameter is unknown or out of its bounds.
    """
    values = values_for(path, NODE)
    try:
        return build(EkfNodeConfig, {name: value for name, value in values.items() if name not in IGNORED}), read_text(
            path, MAX_BYTES
        )
    except DiffbotError as error:
        raise DiffbotError(f"{path}: {error}") from error
