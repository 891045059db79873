"""Files: read within bounds, checked before they are written, and replaced whole or not at all; folders of the user."""

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
from pathlib import Path
from typing import Any, BinaryIO

import platformdirs

from diffbot_core.errors import DiffbotError, InvalidValueError, shown

MCAP = b"\x89MCAP0\r\n"
"""the first bytes of an MCAP file"""
_BAG = b"rosbag2_bagfile_information"
"""occurs in the metadata.yaml of a bag"""
_REPORT = (b"<", b"{")
"""first byte of a report that a command writes: HTML or JSON"""
_PICTURE, _PLOTTED = b"\x89PNG", b"Matplotlib"
"""first bytes of a picture, and what stands near them in a picture that a command draws"""


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


def read_text(path: Path, max_bytes: int) -> str:
    """Return the text of a regular file.

    Raises:
        DiffbotError: if it cannot be read, is longer than ``max_bytes`` or not UTF-8.
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
    """Refuse an output of a command that would destroy something else: a bag, an input, a file of another kind.

    Args:
        path: path of a file or folder; it need not exist.
        inputs: files that the command reads.

    Raises:
        DiffbotError: naming what is there.
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
        raise DiffbotError(f"cannot write to {path}: the command reads it; choose another name")
    begin = _begin_of(path, 256)
    if begin and not begin.startswith(_REPORT) and not (begin.startswith(_PICTURE) and _PLOTTED in begin):
        raise DiffbotError(f"{path} already exists and is not a report of diffbot; choose another name")


def is_bag_folder(folder: Path) -> bool:
    """Return True if a folder is a bag of rosbag2, finished or not."""
    return (folder / f"{folder.name}_0.mcap").is_file() or _BAG in _begin_of(folder / "metadata.yaml", 4096)


def _bag_around(path: Path) -> str:
    """Return why a file must not be written here: it is in the folder of a bag; empty if it is not."""
    # Absolute, and without links: these could lead into a bag.
    for folder in Path(os.path.realpath(path)).parents:
        if is_bag_folder(folder):
            return f"{folder} is a bag"
    return ""


def _begin_of(path: Path, size: int) -> bytes:
    try:
        # Reading a pipe would block.
        with path.open("rb") if path.is_file() else io.BytesIO() as file:
            return file.read(size)
    except OSError:
        return b""


@contextmanager
def output_folder(folder: Path) -> Iterator[Path]:
    """Make a folder and check that it can be written to; an OSError inside the ``with`` block is reported as its own.

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
        # Reading a pipe or a device would block.
        usable = bool(path.name) and "\0" not in text and (path.is_file() or not path.exists())
    except (OSError, RuntimeError, ValueError):
        usable = False
    if not usable:
        raise InvalidValueError(name, text, "the path of a file")
    return path


@contextmanager
def replacing(path: Path, *, durable: bool = False, in_bag: bool = False) -> Iterator[Path]:
    """Give a temporary name beside ``path``; what the ``with`` block writes there then replaces the file in one step.

    A reader sees the old file or the new one, never a part. If the block fails, the old file stays and the new one is
    deleted.

    Args:
        path: the file to write; its folder must exist.
        durable: bring the contents to the disk before the renaming, so that a power cut leaves one of both files.
        in_bag: the file belongs to a bag; otherwise a path in a bag is refused.

    Raises:
        OSError: if the file cannot be written, is not a regular file, or belongs to a bag.
    """
    if not in_bag and (reason := _bag_around(path) or (_begin_of(path, len(MCAP)) == MCAP and "it is an MCAP file")):
        raise FileExistsError(errno.EEXIST, reason)
    if path.exists() and not path.is_file():
        raise FileExistsError(errno.EEXIST, "it is not a regular file")
    part = path.with_name(f".{path.name}.{os.getpid()}.part")
    part.unlink(missing_ok=True)
    # Never through a link that somebody else has put there.
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
    """Write a text in UTF-8; see :func:`replacing`.

    Raises:
        OSError: if it cannot be written.
    """
    with replacing(path, durable=durable, in_bag=in_bag) as part:
        part.write_text(text, encoding="utf-8")


def write_json(path: Path, content: Any, indent: int = 1) -> None:
    """Write JSON; infinite limits and bounds become texts, since JSON has no infinity; see :func:`replacing`.

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


def cache_folder() -> Path:
    """Return the folder of this user's cache, such as ``~/.cache/diffbot``.

    Raises:
        DiffbotError: if it cannot be made.
    """
    return _made(platformdirs.user_cache_path("diffbot"))


@functools.cache
def runtime_folder() -> Path:
    """Return this user's folder for files of running programs; if it cannot be made, one of this process.

    Without a session ($XDG_RUNTIME_DIR), as in a container, it is a part of the cache.
    """
    session = os.environ.get("XDG_RUNTIME_DIR")
    try:
        return _made(Path(session) / "diffbot") if session else _made(cache_folder() / "run")
    except DiffbotError:
        made = Path(tempfile.mkdtemp(prefix="diffbot-"))
        atexit.register(shutil.rmtree, made, ignore_errors=True)
        return made


def _made(folder: Path) -> Path:
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    except OSError as error:
        raise DiffbotError(f"cannot make the folder {folder}: {error.strerror}") from None
    return folder
