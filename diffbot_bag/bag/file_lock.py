"""Locks (flock) on what is being written: a file of a recording, the temporary folder of a bag.

A lock ends with its process, however that ends. Where the file system has no locks, none is held.
"""

from __future__ import annotations

import contextlib
import fcntl
import os
import shutil
from collections.abc import Iterable, Iterator
from pathlib import Path

from diffbot_core.errors import DiffbotError
from diffbot_core.foreign_files import open_regular, shown


def take_lock(descriptor: int) -> bool:
    """Lock an open file or folder without waiting; return False if another process has it locked."""
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:
        pass
    return True


@contextlib.contextmanager
def locked_files(paths: Iterable[Path]) -> Iterator[None]:
    """Hold the locks of files that are to be replaced or deleted.

    Raises:
        DiffbotError: if a recorder writes one of them, or one is not a regular file.
    """
    with contextlib.ExitStack() as opened:
        for path in paths:
            stream = opened.enter_context(open_regular(path))
            if not take_lock(stream.fileno()):
                raise DiffbotError(f"{shown(path)} is being recorded: end the recorder first")
        yield


@contextlib.contextmanager
def part_folder(path: Path) -> Iterator[Path]:
    """Give a new hidden folder beside ``path``, and delete it in the end; those of killed processes are deleted, too.

    Raises:
        OSError: if it cannot be made.
    """
    part = path.with_name(f".{path.name}.{os.getpid()}.part")
    part.parent.mkdir(parents=True, exist_ok=True)
    _delete_dead(path)
    part.mkdir()
    descriptor = os.open(part, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        take_lock(descriptor)
        yield part
    finally:
        shutil.rmtree(part, ignore_errors=True)
        os.close(descriptor)


def _delete_dead(path: Path) -> None:
    """Delete the hidden folders beside ``path`` whose process has ended without doing so."""
    begin, end = f".{path.name}.", ".part"
    for entry in path.parent.iterdir():
        number = entry.name[len(begin) : -len(end)]
        if not (entry.name.startswith(begin) and entry.name.endswith(end) and number.isdecimal()):
            continue
        with contextlib.suppress(OSError):
            descriptor = os.open(entry, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW | os.O_CLOEXEC)
            try:
                # Between the making of a folder and its lock, the process tells.
                if take_lock(descriptor) and (int(number) == os.getpid() or not Path("/proc", number).exists()):
                    shutil.rmtree(entry, ignore_errors=True)
            finally:
                os.close(descriptor)
