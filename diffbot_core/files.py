"""Folders and files that results are written to: checked before the work, and replaced whole or not at all."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from diffbot_core.errors import DiffbotError, InvalidValueError


@contextmanager
def output_folder(folder: Path) -> Iterator[Path]:
    """Make a folder and check that it can be written to; a failure inside the ``with`` block is reported as its own.

    Raises:
        DiffbotError: if the folder, or a file in it, cannot be written.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        if not os.access(folder, os.W_OK):
            raise DiffbotError(f"cannot write to {folder}")
        yield folder
    except OSError as error:
        raise DiffbotError(f"cannot write to {folder}: {error.strerror}") from None


def file_path(name: str, text: str) -> Path | None:
    """Return the path that the parameter ``name`` gives, ``~`` expanded; None for an empty text.

    Raises:
        InvalidValueError: if it cannot be the path of a file.
    """
    if not text:
        return None
    try:
        path = Path(text).expanduser()
        # A pipe or a device would be waited for.
        usable = bool(path.name) and "\0" not in text and (path.is_file() or not path.exists())
    except (OSError, RuntimeError, ValueError):
        usable = False
    if not usable:
        raise InvalidValueError(name, text, "the path of a file")
    return path


PRIVATE = 0o600
"""Mode of a file that this user alone may write, whatever the umask: as read_own of ``foreign_files`` demands"""


@contextmanager
def replacing(path: Path, *, durable: bool = False, mode: int = 0o666) -> Iterator[Path]:
    """Give a temporary name beside ``path``; what the ``with`` block writes there then takes its place in one step.

    A reader sees the old file or the new one, never a part. If the block fails, the old file stays and the new one is
    deleted.

    Args:
        path: the file to write; its folder must exist.
        durable: bring the contents to the disk before the renaming, so that a power cut leaves one of both files.
        mode: of the new file, less the umask.

    Raises:
        OSError: if the file cannot be written.
    """
    part = path.with_name(f".{path.name}.{os.getpid()}.part")
    part.unlink(missing_ok=True)
    # Never through a link that somebody else has put there.
    os.close(os.open(part, os.O_WRONLY | os.O_CREAT | os.O_EXCL, mode))
    try:
        yield part
        if durable:
            with part.open("rb") as file:
                os.fsync(file.fileno())
        part.replace(path)
    except BaseException:
        part.unlink(missing_ok=True)
        raise


def write_text(path: Path, text: str, *, durable: bool = False, mode: int = 0o666) -> None:
    """Write a text in UTF-8; see :func:`replacing`.

    Raises:
        OSError: if it cannot be written.
    """
    with replacing(path, durable=durable, mode=mode) as part:
        part.write_text(text, encoding="utf-8")


def write_json(path: Path, content: Any, indent: int = 1) -> None:
    """Write JSON; infinite limits and bounds become texts, as JSON has no word for them; see :func:`replacing`.

    Raises:
        OSError: if it cannot be written.
    """
    write_text(path, json.dumps(_finite(content), indent=indent, allow_nan=False) + "\n")


def _finite(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _finite(one) for key, one in value.items()}
    if isinstance(value, (list, tuple)):
        return [_finite(one) for one in value]
    return str(value) if isinstance(value, float) and not math.isfinite(value) else value
