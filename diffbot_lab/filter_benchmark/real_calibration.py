"""Calibration on real drives: on the first third of each, judged on the rest; and the first robot's on the others.

A drive of less than three minutes is calibrated on, and judged on, as a whole.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from tqdm import tqdm

from diffbot_core.files import write_text
from diffbot_lab.filter_benchmark.real_drives import DriveResult, filtered_with
from diffbot_lab.targets import markdown_table
from diffbot_tools.calibration.calibrate import calibrate
from diffbot_tools.calibration.calibrated_file import calibrated_file as calibrated_text
from diffbot_tools.calibration.command import read_drive
from diffbot_tools.calibration.parameters import outcome_of
from diffbot_tools.dataset.bag import EKF_FILE
from diffbot_tools.refilter.comparison import Errors, Figures, figures_of
from diffbot_tools.refilter.parameters import read_config

SHARE = 1.0 / 3.0
"""of each drive that is calibrated on"""
_SHORT = 180.0
"""[s]"""
TITLES = ("drive", "calibrated on", "shipped: RMSE [m]", "NEES", "calibrated: RMSE [m]", "NEES")
TITLES_OF_OTHERS = ("drive", "shipped: RMSE [m]", "NEES", "with the first one's calibration: RMSE [m]", "NEES")
_REST, _WHOLE = ("rest_shipped", "rest_calibrated"), ("whole_shipped", "whole_with_first")


def study(found: list[DriveResult], folder: Path) -> list[dict[str, Any]]:
    """Calibrate and judge each drive; the bags of ``found`` exist still, and parameter files go to ``folder``.

    Raises:
        DiffbotError: if a drive is too short to be calibrated on.
    """
    rows = []
    first: Path | None = None
    for number, one in enumerate(found):
        parameters = calibrated_file(one, folder / f"calibrated_{number}.yaml")
        own, _ = filtered_with(one.bag, parameters)
        row = {
            "name": one.name,
            "calibrated_on": "the whole" if used_of(one.errors) == 1.0 else "the first third",
            "rest_shipped": _figures(rest_of(one.errors)),
            "rest_calibrated": _figures(rest_of(own)),
            "whole_shipped": _figures(one.errors),
            "whole_with_first": _figures(filtered_with(one.bag, first)[0]) if first is not None else None,
        }
        first = first or parameters
        rows.append(row)
    return rows


def calibrated_file(one: DriveResult, path: Path) -> Path:
    """Calibrate on the first part of a drive and write the parameter file, which is returned."""
    config, _ = read_config(one.bag / EKF_FILE)
    until = used_of(one.errors) * float(one.errors.time[-1])
    events, _ = read_drive(one.bag, config, until, {})
    with tqdm(desc=f"calibrate {one.name}", unit="run", disable=None) as bar:
        outcome = outcome_of(calibrate([events], config, bar.update), config)
    write_text(path, calibrated_text(one.bag / EKF_FILE, config, outcome, None, f"Calibrated on {one.name}."))
    return path


def used_of(errors: Errors) -> float:
    """Return the share of a drive that is calibrated on."""
    return 1.0 if errors.time[-1] < _SHORT else SHARE


def rest_of(errors: Errors) -> Errors:
    """Return the errors that a calibration is judged by: after the part that it has used, or all."""
    share = used_of(errors)
    use = errors.time >= (0.0 if share == 1.0 else share * float(errors.time[-1]))
    return Errors(errors.time[use], errors.truth[use], errors.error[use], errors.P[use])


def _figures(errors: Errors) -> dict[str, Any]:
    figures: Figures = figures_of(errors)
    return {"rmse": figures.rmse, "largest": figures.largest, "nees": figures.nees}


def calibrated_table(rows: list[dict[str, Any]]) -> str:
    """Return two tables in Markdown: the rest of each drive, and whole drives with the first one's calibration.

    The second is left out if no drive has that calibration.
    """
    rest = [(row["name"], row["calibrated_on"], *_cells(row, _REST)) for row in rows]
    others = [row for row in rows if row["whole_with_first"] is not None]
    if len(rows) > 1:
        rest.append(("mean", "", *_cells(_means(rows, _REST), _REST)))
    if not others:
        return "\n".join(markdown_table(TITLES, rest))
    whole = [(row["name"], *_cells(row, _WHOLE)) for row in others]
    whole.append(("mean", *_cells(_means(others, _WHOLE), _WHOLE)))
    return "\n".join([*markdown_table(TITLES, rest), "", *markdown_table(TITLES_OF_OTHERS, whole)])


def _means(rows: list[dict[str, Any]], columns: tuple[str, str]) -> dict[str, dict[str, float]]:
    return {
        column: {name: sum(row[column][name] for row in rows) / len(rows) for name in ("rmse", "nees")}
        for column in columns
    }


def _cells(row: dict[str, Any], columns: tuple[str, str]) -> list[str]:
    return [text for column in columns for text in (f"{row[column]['rmse']:.3f}", f"{row[column]['nees']:.1f}")]
