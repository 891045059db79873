"""A bag that is written as a whole: under a temporary name, which becomes the real one when it is complete."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from diffbot_bag.bag.file_lock import part_folder
from diffbot_bag.bag.message_definitions import MessageDefinitions
from diffbot_bag.bag.writer import BagWriteError, BagWriter


def check_new(folder: Path) -> Path:
    """Return the absolute path of a bag that does not exist yet.

    Raises:
        BagWriteError: if it does.
    """
    folder = folder.expanduser().absolute()
    if os.path.lexists(folder):
        raise BagWriteError(f"{folder} exists already: choose another name for the bag")
    return folder


@contextmanager
def new_bag_folder(folder: Path) -> Iterator[Path]:
    """Yield a temporary path; the folder made there appears at ``folder`` when the ``with`` block ends.

    After a failure nothing appears. The temporary folder has the bag's name, as the names of files contain it.

    Raises:
        BagWriteError: if ``folder`` exists already or cannot be written.
    """
    folder = check_new(folder)
    try:
        with part_folder(folder) as part:
            yield part / folder.name
            (part / folder.name).rename(folder)
    except OSError as error:
        raise BagWriteError(f"cannot write the bag {folder}: {error.strerror or error}") from error


@contextmanager
def new_bag(folder: Path, definitions: MessageDefinitions | None = None) -> Iterator[BagWriter]:
    """Yield the writer of a bag that appears at ``folder`` when the ``with`` block ends; after a failure, nothing does.

    Other files of the bag belong into the writer's ``folder``.

    Raises:
        BagWriteError: if ``folder`` exists already or cannot be written.
    """
    with new_bag_folder(folder) as part:
        writer = BagWriter(part, definitions)
        try:
            yield writer
        finally:
            writer.close()
