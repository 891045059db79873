"""The command ``diffbot interfaces build``."""

from __future__ import annotations

import argparse
import importlib.util
from pathlib import Path
from typing import Any

from tqdm import tqdm

from diffbot_core.errors import DiffbotError
from diffbot_tools.interfaces.build import build_interfaces, default_folder, steps
from diffbot_tools.interfaces.definitions import ACTIONS, PACKAGE


def add_interfaces(commands: Any) -> None:
    """Add ``diffbot interfaces`` to the subparsers of the command line."""
    interfaces = commands.add_parser("interfaces", help="build Nav2's actions for an environment of wheels")
    names = interfaces.add_subparsers(required=True, metavar="ACTION")
    build = names.add_parser("build", help=f"build {', '.join(ACTIONS)} of {PACKAGE} (needs gcc and g++)")
    build.add_argument("--out", type=Path, default=None, help="private folder (default: in the user's cache)")
    build.set_defaults(call=_build)


def _build(options: argparse.Namespace) -> int:
    folder = default_folder() if options.out is None else options.out
    folder = folder.expanduser().absolute()
    if importlib.util.find_spec(PACKAGE) is not None:
        raise DiffbotError(f"{PACKAGE} is installed: there is nothing to build")
    with tqdm(total=steps(), disable=None, leave=False, unit="step") as bar:

        def show(step: str) -> None:
            bar.set_description(step)
            bar.update()

        package = build_interfaces(folder, show)
    print(f"{package} written; the controllers serve the actions, and clients find them, after")
    print(f'export PYTHONPATH="{folder}${{PYTHONPATH:+:$PYTHONPATH}}"')
    return 0
