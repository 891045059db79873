"""Calibration on real drives: on the first third of each, judged on the rest; and the first robot's on the others.

A drive of less than three minutes is calibrated on, and judged on, as a whole.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from tqdm import tqdm

from diffbot_core.files import write_text
from diffbot_lab.benchmark.targets import markdown_table
from diffbot_lab.calibration.calibrate import calibrate
from diffbot_lab.calibration.command import read_drive
from diffbot_lab.calibration.parameters import given_parameters, outcome_of, parameter_file
from diffbot_lab.dataset.bag import EKF_FILE
from diffbot_lab.dataset.benchmark import DriveResult, filtered_with
from diffbot_lab.refilter.comparison import Errors, Figures, figures_of
from diffbot_lab.refilter.parameters import read_config

SHARE = 1.0 / 3.0
"""of each drive that is calibrated on"""
_SHORT = 180.0
"""[s]"""
TITLES = (
    "drive", "calibrated on", "rest, shipped: RMSE [m]", "NEES", "rest, calibrated: RMSE [m]", "NEES",
    "whole drive, shipped: RMSE [m]", "NEES", "with the first one's calibration: RMSE [m]", "NEES",
)  # fmt: skip
_COLUMNS = ("rest_shipped", "rest_calibrated", "whole_shipped", "whole_with_first")


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
    write_text(path, parameter_file(given_parameters(config), outcome, None, f"Calibrated on {one.name}."))
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
    """Return the table of all drives in Markdown, with the mean of the drives that have a column."""
    lines = [_line(row["name"], row, row["calibrated_on"]) for row in rows]
    if len(rows) > 1:
        lines.append(_line("mean", {column: _mean(rows, column) for column in _COLUMNS}))
        others = [row for row in rows if row["whole_with_first"] is not None]
        lines.append(_line("mean of all but the first", {column: _mean(others, column) for column in _COLUMNS}))
    return "\n".join(markdown_table(TITLES, lines))


def _mean(rows: list[dict[str, Any]], column: str) -> dict[str, float] | None:
    known = [row[column] for row in rows]
    if None in known:
        return None
    return {name: sum(one[name] for one in known) / len(known) for name in ("rmse", "nees")}


def _line(name: str, row: dict[str, Any], share: str = "") -> tuple[str, ...]:
    cells = []
    for column in _COLUMNS:
        one = row[column]
        cells += ["-", "-"] if one is None else [f"{one['rmse']:.3f}", f"{one['nees']:.1f}"]
    return name, share, *cells
