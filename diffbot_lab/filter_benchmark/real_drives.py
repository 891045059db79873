"""``diffbot benchmark real``: the shipped settings on every drive of a data set, against its reference system."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

from diffbot_bag.bag.reader import BagReader
from diffbot_control.filter.localization import FilterEstimate
from diffbot_core.errors import DiffbotError
from diffbot_lab.targets import markdown_table
from diffbot_tools.dataset.bag import EKF_FILE, write_drive
from diffbot_tools.dataset.drive import Drive
from diffbot_tools.dataset.labyrinth import INPUT, read_labyrinth
from diffbot_tools.dataset.mrclam import read_mrclam, robots_in
from diffbot_tools.refilter.command import drive, filter_run
from diffbot_tools.refilter.comparison import (
    Consistency,
    Errors,
    Figures,
    consistency_of,
    errors_of,
    figures_of,
    read_truth,
)
from diffbot_tools.refilter.parameters import read_config

TITLES = (
    "drive", "RMSE [m]", "largest [m]", "heading [rad]", "NEES", "NIS per number", "whiteness", "rejected",
)  # fmt: skip


class DriveResult(NamedTuple):
    """The filter on one drive."""

    name: str
    bag: Path
    figures: Figures
    consistency: Consistency
    errors: Errors


def drives_in(folder: Path) -> list[Callable[[], Drive]]:
    """Return a reader for each drive in a folder: all robots of a set of MR.CLAM, or the Labyrinth data set.

    Raises:
        DiffbotError: if the folder has the files of neither.
    """
    robots = robots_in(folder)
    if robots:
        return [lambda robot=robot: read_mrclam(folder, robot) for robot in robots]  # type: ignore[misc]
    if (folder / INPUT).is_file():
        return [lambda: read_labyrinth(folder)]
    raise DiffbotError(f"{folder} has neither RobotN_Odometry.dat of MR.CLAM nor {INPUT} of the Labyrinth data set")


def evaluate(recorded: Drive, folder: Path) -> DriveResult:
    """Import a drive to a bag in ``folder`` and filter it with the settings that the import ships.

    Raises:
        DiffbotError: if the drive cannot be imported or the filter never starts.
    """
    bag = bag_of(recorded, folder)
    write_drive(recorded, bag)
    errors, consistency = filtered_with(bag, bag / EKF_FILE)
    return DriveResult(recorded.name, bag, figures_of(errors), consistency, errors)


def bag_of(recorded: Drive, folder: Path) -> Path:
    """Return the path of the bag of a drive."""
    return folder / recorded.name.replace(" ", "_").replace(",", "")


def filtered_with(bag: Path, parameters: Path) -> tuple[Errors, Consistency]:
    """Filter a bag with a parameter file, and compare with its /ground_truth.

    Raises:
        DiffbotError: if a file is bad, or the filter never starts.
    """
    config, _ = read_config(parameters)
    estimates: list[FilterEstimate] = []
    with BagReader(bag) as reader:
        truth = read_truth(reader, "/ground_truth")
        filtered = filter_run(reader, config, {})
        drive(filtered, reader, lambda answer, _: estimates.append(answer.estimate))
    return errors_of(estimates, truth), consistency_of(filtered.localization.innovations)


def results_of(found: list[DriveResult]) -> dict[str, Any]:
    """Return the content of results.json; what was not measured is null."""
    drives = [
        {"name": one.name}
        | {name: _known(value) for name, value in (one.figures._asdict() | one.consistency._asdict()).items()}
        for one in found
    ]
    return {"drives": drives}


def _known(value: float) -> float | None:
    return None if math.isnan(value) else value


def table(results: dict[str, Any]) -> str:
    """Return the table of all drives in Markdown, with the mean of several."""
    drives = results["drives"]
    lines = [_row(one) for one in drives]
    if len(drives) > 1:
        names = ("seconds", "rmse", "largest", "heading_rmse", "nees", "nis", "correlation", "rejected", "accepted")
        columns = {name: [one[name] for one in drives] for name in names}
        mean = {name: None if None in values else sum(values) / len(values) for name, values in columns.items()}
        lines.append(_row({"name": "mean"} | mean))
    return "\n".join(markdown_table(TITLES, lines))


def _row(one: dict[str, Any]) -> tuple[str, ...]:
    formats = {
        "rmse": ".3f", "largest": ".2f", "heading_rmse": ".3f", "nees": ".1f", "nis": ".2f",
        "correlation": "+.2f",
    }  # fmt: skip
    values = ["-" if one[name] is None else format(one[name], form) for name, form in formats.items()]
    total = one["accepted"] + one["rejected"]
    drive = f"{one['name']}, {one['seconds']:.0f} s"
    return drive, *values, f"{100.0 * one['rejected'] / total:.1f} %" if total else "-"
