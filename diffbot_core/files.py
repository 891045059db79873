"""Folders that commands write their results to."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from diffbot_core.errors import DiffbotError


@contextmanager
def output_folder(folder: Path) -> Iterator[Path]:
    """Make a folder and check it before the work is done; what fails in it is told as its failure.

    Raises:
        DiffbotError: if the folder, or something in it, cannot be written.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        if not os.access(folder, os.W_OK):
            raise DiffbotError(f"cannot write to {folder}")
        yield folder
    except OSError as error:
        raise DiffbotError(f"cannot write to {folder}: {error.strerror}") from None
