"""The command ``diffbot report``: write an HTML file about a bag, and CSV and TUM files beside it."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from diffbot_core.errors import DiffbotError

MAX_BAGS = 3
"""Bags in one report."""


def add_report(commands: Any) -> None:
    """Add ``diffbot report`` to the subparsers of the command line."""
    from diffbot_control.law.presets import PRESETS  # noqa: PLC0415

    report = commands.add_parser("report", help="write a page about a recorded bag, one HTML file")
    report.add_argument(
        "bag",
        type=Path,
        nargs="+",
        help=f"folder or .mcap file of a bag; up to {MAX_BAGS} are laid over each other",
    )
    report.add_argument("-o", "--out", type=Path, help="file to write (default: BAG.html beside the bag)")
    report.add_argument(
        "--preset",
        choices=tuple(PRESETS),
        help="whose tolerances and limits are drawn (default: those that the recorder noted in the bag, else tuned)",
    )
    for flag, what in (("csv", "a table"), ("tum", "trajectories for evo")):
        report.add_argument(f"--{flag}", action="store_true", help=f"write {what} beside it, too")
    report.set_defaults(call=_call)


def _call(options: argparse.Namespace) -> int:
    out = options.out or options.bag[0].resolve().with_suffix(".html")
    return run(options.bag, out, options.preset, options.csv, options.tum)


def run(bags: Sequence[Path], out: Path, preset: str | None = None, csv: bool = False, tum: bool = False) -> int:
    """Write the report of a bag, or of several bags laid over each other, and print the names of the files.

    Raises:
        DiffbotError: if a bag cannot be read, or a file cannot be written.
    """
    out = out.expanduser()
    if out.suffix.lower() not in (".html", ".htm"):
        raise DiffbotError(f"--out {out}: must end with .html")
    if not out.parent.is_dir():
        raise DiffbotError(f"--out {out}: no folder {out.parent}")
    if len(bags) > MAX_BAGS:
        raise DiffbotError(f"{len(bags)} bags: must be at most {MAX_BAGS}")
    if len(bags) > 1 and (csv or tum):
        raise DiffbotError("--csv and --tum: only with one bag")
    bag, *others = (one.expanduser() for one in bags)
    files = write_report(bag, out, preset, csv, tum, others)
    print(f"Report {out}" + (f", beside it {', '.join(path.name for path in files)}" if files else ""))
    return 0


def write_report(
    bag: Path,
    out: Path,
    preset: str | None = None,
    csv: bool = False,
    tum: bool = False,
    others: Sequence[Path] = (),
) -> list[Path]:
    """Write the page ``out`` atomically; return the files beside it.

    With several bags, the times of each bag begin with its first goal.

    Raises:
        DiffbotError: if the bag cannot be read, or a file cannot be written.
    """
    # Only the called command loads what it needs.
    from diffbot_control.law.presets import PRESETS  # noqa: PLC0415
    from diffbot_core.files import write_text  # noqa: PLC0415
    from diffbot_tools.view.bag_source import read_bag  # noqa: PLC0415
    from diffbot_tools.view.page_file import html  # noqa: PLC0415
    from diffbot_tools.view.report import export, page_data  # noqa: PLC0415

    config = None if preset is None else PRESETS[preset].config
    found = [read_bag(one, config, bool(others)) for one in (bag, *others)]
    try:
        write_text(out, html(page_data(*found)))
        return export(found[0], out, csv, tum)
    except OSError as error:
        raise DiffbotError(f"cannot write {out}: {error.strerror or error}") from error
