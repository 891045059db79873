"""Folders and files that results are written to: checked before the work, and replaced whole or not at all."""

from __future__ import annotations

import errno
import io
import json
import math
import os
import stat
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from diffbot_core.errors import DiffbotError, InvalidValueError

MCAP = b"\x89MCAP0\r\n"
"""the first bytes of a file of a bag"""
_BAG = b"rosbag2_bagfile_information"
"""in the metadata.yaml of a bag"""
_REPORT = (b"<", b"{")
"""first byte of what commands write as a report: HTML or JSON"""
_PICTURE, _PLOTTED = b"\x89PNG", b"Matplotlib"
"""first bytes of a picture, and what stands near them in one that a command draws"""


def check_output(path: Path, inputs: Iterable[Path] = ()) -> None:
    """Refuse an output of a command that would destroy what is no output: a bag, an input, a file of another kind.

    Args:
        path: of a file or folder; it need not exist.
        inputs: files that the command reads.

    Raises:
        DiffbotError: naming what stands there.
    """
    if reason := _bag_around(path):
        raise DiffbotError(f"cannot write to {path}: {reason}")
    try:
        mode = path.lstat().st_mode
    except (OSError, ValueError):
        return
    if stat.S_ISDIR(mode):
        return
    if stat.S_ISLNK(mode):
        raise DiffbotError(f"cannot write to {path}: it is a symbolic link")
    if not stat.S_ISREG(mode):
        raise DiffbotError(f"cannot write to {path}: it is neither a file nor a folder")
    if any(one.exists() and one.samefile(path) for one in inputs):
        raise DiffbotError(f"cannot write to {path}: it exists already, and the command reads it: choose another name")
    begin = _begin_of(path, 256)
    if begin and not begin.startswith(_REPORT) and not (begin.startswith(_PICTURE) and _PLOTTED in begin):
        kinds = "no report (HTML, JSON) and no plotted picture"
        raise DiffbotError(f"cannot write to {path}: it exists already, and is {kinds}: choose another name")


def _bag_around(path: Path) -> str:
    """Return why a file must not be written here: it is in the folder of a bag; empty if it is not."""
    # Absolute, and without links: these could lead into a bag.
    for folder in Path(os.path.realpath(path)).parents:
        if is_bag_folder(folder):
            return f"{folder} is a bag"
    return ""


def is_bag_folder(folder: Path) -> bool:
    """Return whether a folder is a bag of rosbag2, finished or not."""
    return (folder / f"{folder.name}_0.mcap").is_file() or _BAG in _begin_of(folder / "metadata.yaml", 4096)


def _begin_of(path: Path, size: int = len(MCAP)) -> bytes:
    try:
        # A pipe would be waited for.
        with path.open("rb") if path.is_file() else io.BytesIO() as file:
            return file.read(size)
    except OSError:
        return b""


def _check_replaceable(path: Path) -> None:
    """Refuse to replace a file of a bag, a pipe or a device, whoever asks for it.

    Raises:
        OSError: with the reason.
    """
    if reason := _bag_around(path):
        raise FileExistsError(errno.EEXIST, reason)
    if path.exists() and not path.is_file():
        raise FileExistsError(errno.EEXIST, "it is no file")
    if _begin_of(path) == MCAP:
        raise FileExistsError(errno.EEXIST, "it is an MCAP file")


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
        if is_bag_folder(folder):
            raise DiffbotError(f"cannot write to {folder}: it is a bag")
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
def replacing(path: Path, *, durable: bool = False, mode: int = 0o666, in_bag: bool = False) -> Iterator[Path]:
    """Give a temporary name beside ``path``; what the ``with`` block writes there then takes its place in one step.

    A reader sees the old file or the new one, never a part. If the block fails, the old file stays and the new one is
    deleted.

    Args:
        path: the file to write; its folder must exist.
        durable: bring the contents to the disk before the renaming, so that a power cut leaves one of both files.
        mode: of the new file, less the umask.
        in_bag: the file belongs to a bag; else a path in one is refused, since nothing of a bag is replaced by mistake.

    Raises:
        OSError: if the file cannot be written, is no file, or belongs to a bag.
    """
    if not in_bag:
        _check_replaceable(path)
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


def write_text(path: Path, text: str, *, durable: bool = False, mode: int = 0o666, in_bag: bool = False) -> None:
    """Write a text in UTF-8; see :func:`replacing`.

    Raises:
        OSError: if it cannot be written.
    """
    with replacing(path, durable=durable, mode=mode, in_bag=in_bag) as part:
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
