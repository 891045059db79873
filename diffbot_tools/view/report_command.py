"""The command ``diffbot report``: write an HTML page about a bag, and CSV and TUM files beside it."""

from __future__ import annotations

import argparse
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Any

from diffbot_core.errors import DiffbotError
from diffbot_tools.arguments import add_remap, once

MAX_BAGS = 3
"""Largest number of bags in one report."""


def add_report(commands: Any) -> None:
    """Add ``diffbot report`` to the subparsers of the command line."""
    from diffbot_control.law.registry import PRESETS  # noqa: PLC0415

    report = commands.add_parser("report", help="write a page about a recorded bag, one HTML file")
    report.add_argument(
        "bag",
        type=Path,
        nargs="+",
        help=f"folder or .mcap file of a bag; several bags, at most {MAX_BAGS}, are compared on one page",
    )
    report.add_argument("-o", "--out", type=Path, help="file to write (default: BAG.html beside the bag)")
    report.add_argument(
        "--preset",
        choices=tuple(PRESETS),
        help="draw the tolerances and limits of this preset (default: the recorded parameters, else tuned)",
    )
    report.add_argument("--csv", action="store_true", help="also write a table beside the page")
    report.add_argument("--tum", action="store_true", help="also write trajectories for evo beside the page")
    add_remap(report, _names, "topic in the bags for a topic that the page shows, e.g. odom:=/base/odom")
    report.set_defaults(call=_call)


def _names() -> Collection[str]:
    from diffbot_tools.view.bag_source import ROLES  # noqa: PLC0415

    return [name for names, _ in ROLES.values() for name in names]


def _call(options: argparse.Namespace) -> int:
    bag, *others = options.bag
    path = bag.resolve()
    out = options.out or path.with_name(f"{path.name.removesuffix('.mcap')}.html")
    if out.suffix.lower() not in (".html", ".htm"):
        raise DiffbotError(f"--out {out}: the name must end with .html")
    if not out.parent.is_dir():
        raise DiffbotError(f"--out {out}: the folder {out.parent} does not exist")
    if len(others) >= MAX_BAGS:
        raise DiffbotError(f"{len(options.bag)} bags are too many for one report: give at most {MAX_BAGS}")
    if others and (options.csv or options.tum):
        raise DiffbotError("--csv and --tum work with one bag only")
    files = write_report(bag, out, options.preset, options.csv, options.tum, others, once("--remap", options.remap))
    print(f"Report {out}" + (f", beside it {', '.join(path.name for path in files)}" if files else ""))
    return 0


def write_report(
    bag: Path,
    out: Path,
    preset: str | None = None,
    csv: bool = False,
    tum: bool = False,
    others: Sequence[Path] = (),
    remap: Mapping[str, str] | None = None,
) -> list[Path]:
    """Write the page ``out`` atomically; return the CSV and TUM files beside it.

    If the page compares ``bag`` with ``others``, the time of each bag begins at its first goal. ``remap`` has the
    topic in the bags for each topic that has another name there.

    Raises:
        DiffbotError: if a bag cannot be read, a file cannot be written, or a remapped topic is missing or has another
            type.
    """
    # Imported here, since the command line imports this module for every command.
    from diffbot_control.law.registry import PRESETS  # noqa: PLC0415
    from diffbot_core.files import write_text  # noqa: PLC0415
    from diffbot_tools.view.bag_source import read_bag  # noqa: PLC0415
    from diffbot_tools.view.page_file import html  # noqa: PLC0415
    from diffbot_tools.view.report import export, page_data  # noqa: PLC0415

    config = None if preset is None else PRESETS[preset].config
    found = [read_bag(one, config, bool(others), remap or {}) for one in (bag, *others)]
    try:
        write_text(out, html(page_data(*found)))
        return export(found[0], out, csv, tum)
    except OSError as error:
        raise DiffbotError(f"cannot write {out}: {error.strerror or error}") from error
