"""A real robot is driven by its own limits: robot.launch.py does not start without them."""

from __future__ import annotations

from pathlib import Path

from diffbot_core.errors import DiffbotError
from diffbot_core.parameter_files import values_for

REQUIRED = (
    "linear.x.max_velocity",
    "angular.z.max_velocity",
    "linear.x.max_acceleration",
    "angular.z.max_acceleration",
)
"""Parameters of the controller whose defaults are the paper's robot's, or no limit at all."""


def check_data_sheet(file: Path) -> None:
    """Refuse a parameter file whose section of the controller lacks a limit of the robot.

    Raises:
        DiffbotError: naming the file and what it lacks, or if it cannot be read.
    """
    values = values_for(file, "controller")
    missing = [name for name in REQUIRED if name not in values]
    if missing:
        raise DiffbotError(
            f"{file}: /**/controller lacks {', '.join(missing)}: a robot is not driven without its limits"
        )
