"""Files of unknown origin: only regular ones are opened, and texts from them are shown in one short line."""

from __future__ import annotations

import errno
import os
import stat
from pathlib import Path
from typing import BinaryIO

from diffbot_core.errors import DiffbotError
from diffbot_core.private_folders import not_own

MAX_SHOWN = 200
"""characters of a foreign text in an error"""


def open_regular(path: Path) -> BinaryIO:
    """Open a file for reading.

    Raises:
        DiffbotError: if it is missing, cannot be read or is not a regular file. A FIFO would block, a device never end.
    """
    try:
        descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
    except OSError as error:
        raise DiffbotError(f"cannot open {shown(path)}: {error.strerror}") from error
    except ValueError as error:
        raise DiffbotError(f"cannot open {shown(path)}: not a path") from error
    if not stat.S_ISREG(os.fstat(descriptor).st_mode):
        os.close(descriptor)
        raise DiffbotError(f"cannot open {shown(path)}: not a regular file")
    return os.fdopen(descriptor, "rb")


def read_own(path: Path, max_bytes: int) -> bytes | None:
    """Return what is in a file that this program wrote and believes; None if there is no file.

    Raises:
        DiffbotError: if another user owns it or can write to it, or it is a link, no regular file, longer than
            ``max_bytes`` or not readable.
    """
    try:
        descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC | os.O_NOFOLLOW)
    except FileNotFoundError:
        return None
    except OSError as error:
        reason = "it is a link" if error.errno == errno.ELOOP else error.strerror
        raise DiffbotError(f"{shown(path)} is not used: {reason}") from None
    found = os.fstat(descriptor)
    trouble = not_own(found) if stat.S_ISREG(found.st_mode) else "it is no regular file"
    if not trouble and found.st_size > max_bytes:
        trouble = f"it has {found.st_size} bytes: must be <= {max_bytes}"
    if trouble:
        os.close(descriptor)
        raise DiffbotError(f"{shown(path)} is not used: {trouble}")
    with os.fdopen(descriptor, "rb") as file:
        return file.read(max_bytes)


def read_text(path: Path, max_bytes: int) -> str:
    """Return the text of a regular file.

    Raises:
        DiffbotError: if it cannot be read, is longer than ``max_bytes`` or not UTF-8.
    """
    with open_regular(path) as file:
        try:
            content = file.read(max_bytes + 1)
        except OSError as error:
            raise DiffbotError(f"cannot read {shown(path)}: {error.strerror}") from error
    if len(content) > max_bytes:
        raise DiffbotError(f"{shown(path)} is too large: must be <= {max_bytes} bytes")
    try:
        return content.decode()
    except UnicodeDecodeError as error:
        raise DiffbotError(f"{shown(path)} is not a YAML file: no UTF-8") from error


def inside(folder: Path, name: str) -> Path:
    """Return the path of a file that a foreign index names.

    Raises:
        DiffbotError: if the name is absolute or leads out of the folder, by ``..`` or by a symbolic link.
    """
    path = folder / name
    try:
        contained = not Path(name).is_absolute() and path.resolve().is_relative_to(folder.resolve())
    except (OSError, ValueError, RuntimeError) as error:
        raise DiffbotError(f"{shown(name)} is no path of a file in {shown(folder)}") from error
    if not contained:
        raise DiffbotError(f"{shown(name)} is outside of {shown(folder)}, the folder of the bag: not read")
    return path


def shown(value: object) -> str:
    """Return a foreign text as it can stand in a message of one line: printable, and of a bounded length."""
    text = str(value)
    if len(text) > MAX_SHOWN:
        text = text[:MAX_SHOWN] + "..."
    return text if text.isprintable() else repr(text)
