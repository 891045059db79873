"""Files of a bag in whatever state it is: a file, a folder with or without metadata.yaml."""

from __future__ import annotations

import re
from pathlib import Path
from typing import NamedTuple

from diffbot_bag.bag import metadata
from diffbot_bag.bag.metadata import BagMetadata
from diffbot_bag.bag.reader import MAX_FILES
from diffbot_core.errors import DiffbotError
from diffbot_core.foreign_files import inside, shown


class BagParts(NamedTuple):
    """What a bag consists of."""

    files: list[Path]
    """In the order of recording, as far as known."""
    missing: list[str]
    """Files that metadata.yaml names, and that are not there."""
    metadata: BagMetadata | None
    """None if there is none, or it cannot be read."""
    note: str = ""
    """What is wrong with metadata.yaml; empty if nothing is."""


def find_parts(bag: Path) -> BagParts:
    """Return the files of a bag: those that metadata.yaml names, then all other MCAP files of the folder.

    Raises:
        DiffbotError: if there is none, too many, or one outside of the folder.
    """
    try:
        return _find_parts(bag.expanduser())
    except (OSError, RuntimeError) as error:
        raise DiffbotError(f"no bag {shown(bag)}: {getattr(error, 'strerror', None) or error}") from error


def _find_parts(bag: Path) -> BagParts:
    if "\0" in str(bag) or not bag.exists():
        raise DiffbotError(f"no bag {shown(bag)}: no such file or folder")
    if not bag.is_dir():
        return BagParts([bag], [], None)
    found = sorted((path.name for path in bag.glob("*.mcap")), key=_natural)
    stored, note = None, ""
    if not (bag / metadata.FILE_NAME).exists():
        note = f"{metadata.FILE_NAME} is missing"
    else:
        try:
            stored = metadata.read(bag)
        except DiffbotError as error:
            if not found:
                raise
            note = str(error)
    names = list(dict.fromkeys([*(stored.files if stored else ()), *found]))
    if len(names) > MAX_FILES:
        raise DiffbotError(f"{shown(bag)} has {len(names)} files: must be <= {MAX_FILES}")
    paths = [inside(bag, name) for name in names]
    files = [path for path in paths if path.exists()]
    if not files:
        raise DiffbotError(f"no bag in {shown(bag)}: it has no MCAP file")
    if len({path.resolve() for path in files}) < len(files):
        raise DiffbotError(f"{shown(bag)} has a file under two names")
    return BagParts(files, [path.name for path in paths if not path.exists()], stored, note)


def _natural(name: str) -> list[tuple[int, str]]:
    """Return a key that sorts run_2 before run_10."""
    return [(int(part), "") if part.isdecimal() and len(part) < 20 else (-1, part) for part in re.split(r"(\d+)", name)]
