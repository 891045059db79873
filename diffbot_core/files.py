"""Read files of limited size, check output paths, replace files atomically, and find the user's folders."""

from __future__ import annotations

import atexit
import errno
import functools
import io
import json
import math
import os
import shutil
import stat
import tempfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from os import PathLike
from pathlib import Path
from typing import Any, BinaryIO

import platformdirs

from diffbot_core.errors import DiffbotError, InvalidValueError, shown

MCAP = b"\x89MCAP0\r\n"
"""The first bytes of an MCAP file."""
_BAG = b"rosbag2_bagfile_information"
"""The metadata.yaml of every bag contains this key."""
_REPORT = (b"<", b"{")
"""Possible first bytes of a report: HTML or XML, JSON."""
_PNG, _MATPLOTLIB = b"\x89PNG", b"Matplotlib"
"""The first bytes of a PNG file, and the name that Matplotlib writes after them."""


def expanded(path: str | PathLike[str]) -> Path:
    """Return a path with ``~`` expanded.

    Raises:
        DiffbotError: if the user after ``~`` is unknown.
    """
    try:
        return Path(path).expanduser()
    except RuntimeError as error:
        raise DiffbotError(f"{shown(path)}: the home folder of this user is unknown") from error


def open_regular(path: Path) -> BinaryIO:
    """Open a file for reading.

    Raises:
        DiffbotError: if the file is missing, cannot be read or is not a regular file.
    """
    try:
        # Without O_NONBLOCK, opening a FIFO blocks.
        descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
    except OSError as error:
        raise DiffbotError(f"cannot open {shown(path)}: {error.strerror}") from error
    except ValueError as error:
        raise DiffbotError(f"cannot open {shown(path)}: not a path") from error
    if not stat.S_ISREG(os.fstat(descriptor).st_mode):
        os.close(descriptor)
        raise DiffbotError(f"cannot open {shown(path)}: not a regular file")
    return os.fdopen(descriptor, "rb")


def read_text(path: Path, max_bytes: int) -> str:
    """Return the text of a regular file.

    Raises:
        DiffbotError: if the file cannot be read, is longer than ``max_bytes`` or is not UTF-8.
    """
    try:
        with open_regular(path) as file:
            content = file.read(max_bytes + 1)
    except OSError as error:
        raise DiffbotError(f"cannot read {shown(path)}: {error.strerror}") from error
    if len(content) > max_bytes:
        raise DiffbotError(f"{shown(path)} is too large: must be <= {max_bytes} bytes")
    try:
        return content.decode()
    except UnicodeDecodeError as error:
        raise DiffbotError(f"{shown(path)} is not a text file in UTF-8") from error


def check_output(path: Path, inputs: Iterable[Path] = ()) -> None:
    """Check that a command may write to ``path``: an existing file must be a report of diffbot.

    Args:
        path: a file or folder, which may be missing.
        inputs: files that the command reads.

    Raises:
        DiffbotError: if the path is in a bag, or is an input, a link or a file of another kind.
    """
    if reason := _bag_problem(path):
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
        raise DiffbotError(f"cannot write to {path}: the command reads it; choose another name")
    first = _first_bytes(path, 256)
    if first and not first.startswith(_REPORT) and not (first.startswith(_PNG) and _MATPLOTLIB in first):
        raise DiffbotError(f"{path} already exists, and only reports are replaced; choose another name")


def is_bag_folder(folder: Path) -> bool:
    """Return True if a folder is a rosbag2 bag, finished or unfinished."""
    return (folder / f"{folder.name}_0.mcap").is_file() or _BAG in _first_bytes(folder / "metadata.yaml", 4096)


def _bag_problem(path: Path) -> str:
    """Return why a file must not be written to ``path``, if a folder above it is a bag; otherwise an empty text."""
    # Links are resolved, because they may lead into a bag.
    for folder in Path(os.path.realpath(path)).parents:
        if is_bag_folder(folder):
            return f"{folder} is a bag"
    return ""


def _first_bytes(path: Path, size: int) -> bytes:
    try:
        # Opening a FIFO would block.
        with path.open("rb") if path.is_file() else io.BytesIO() as file:
            return file.read(size)
    except OSError:
        return b""


@contextmanager
def output_folder(folder: Path) -> Iterator[None]:
    """Create the folder of a command's output, and convert each OSError of the ``with`` block to a DiffbotError.

    Raises:
        DiffbotError: if the folder is a bag, or if the folder or a file in it cannot be written.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        if not os.access(folder, os.W_OK):
            raise DiffbotError(f"cannot write to {folder}: permission denied, or a read-only file system")
        if is_bag_folder(folder):
            raise DiffbotError(f"cannot write to {folder}: it is a bag")
        yield
    except OSError as error:
        raise DiffbotError(f"cannot write to {folder}: {error.strerror}") from None


def file_path(name: str, text: str) -> Path | None:
    """Return the value ``text`` of the parameter ``name`` as a path with ``~`` expanded; None for an empty text.

    Raises:
        InvalidValueError: if the text is not the path of a regular file or of a new file.
    """
    if not text:
        return None
    try:
        path = Path(text).expanduser()
        usable = bool(path.name) and "\0" not in text and (path.is_file() or not path.exists())
    except (OSError, RuntimeError, ValueError):
        usable = False
    if not usable:
        raise InvalidValueError(name, text, "the path of a file")
    return path


@contextmanager
def replacing(path: Path, *, durable: bool = False, in_bag: bool = False) -> Iterator[Path]:
    """Replace a file atomically: the ``with`` block writes a temporary file, which is then renamed to ``path``.

    A reader sees either the old file or the complete new file. If the block fails, the old file stays and the temporary
    file is deleted.

    Args:
        path: the file to write; its folder must exist.
        durable: write the contents to the disk before the renaming, so that they survive a power cut.
        in_bag: allow a path in a bag, and an MCAP file.

    Raises:
        OSError: if the file cannot be written, is not a regular file, or belongs to a bag.
    """
    if not in_bag and (reason := _bag_problem(path)):
        raise FileExistsError(errno.EEXIST, reason)
    if not in_bag and _first_bytes(path, len(MCAP)) == MCAP:
        raise FileExistsError(errno.EEXIST, "it is an MCAP file")
    if path.exists() and not path.is_file():
        raise FileExistsError(errno.EEXIST, "it is not a regular file")
    part = path.with_name(f".{path.name}.{os.getpid()}.part")
    part.unlink(missing_ok=True)
    # O_EXCL refuses a symbolic link, which would redirect the output.
    os.close(os.open(part, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o666))
    try:
        yield part
        if durable:
            with part.open("rb") as file:
                os.fsync(file.fileno())
        part.replace(path)
    except BaseException:
        part.unlink(missing_ok=True)
        raise


def write_text(path: Path, text: str, *, durable: bool = False, in_bag: bool = False) -> None:
    """Write a text in UTF-8; arguments and errors as for :func:`replacing`."""
    with replacing(path, durable=durable, in_bag=in_bag) as part:
        part.write_text(text, encoding="utf-8")


def write_json(path: Path, content: Any) -> None:
    """Write JSON, see :func:`json_text` and :func:`replacing`."""
    write_text(path, json_text(content) + "\n")


def json_text(content: Any) -> str:
    """Return JSON, with inf and nan as texts, because JSON cannot express them."""
    return json.dumps(_finite(content), indent=1, allow_nan=False)


def _finite(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _finite(one) for key, one in value.items()}
    if isinstance(value, (list, tuple)):
        return [_finite(one) for one in value]
    return str(value) if isinstance(value, float) and not math.isfinite(value) else value


def cache_folder() -> Path:
    """Create and return the user's cache folder, such as ``~/.cache/diffbot``.

    Raises:
        DiffbotError: if the folder cannot be created.
    """
    return _created(platformdirs.user_cache_path("diffbot"))


@functools.cache
def runtime_folder() -> Path:
    """Create and return the user's folder for files of running programs.

    The folder is in $XDG_RUNTIME_DIR or, without a login session, in the cache folder. If it cannot be created, this
    process uses a temporary folder.
    """
    session = os.environ.get("XDG_RUNTIME_DIR")
    try:
        return _created(Path(session) / "diffbot") if session else _created(cache_folder() / "run")
    except DiffbotError:
        made = Path(tempfile.mkdtemp(prefix="diffbot-"))
        atexit.register(shutil.rmtree, made, ignore_errors=True)
        return made


def _created(folder: Path) -> Path:
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    except OSError as error:
        raise DiffbotError(f"cannot create the folder {folder}: {error.strerror}") from None
    return folder
