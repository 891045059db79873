"""Folders of this user alone, for caches and locks: nobody else can put a file there that a program would believe."""

from __future__ import annotations

import atexit
import functools
import logging
import os
import shutil
import stat
import tempfile
from pathlib import Path

from diffbot_core.errors import DiffbotError

_NAME = "diffbot"
_OTHERS = 0o077
"""what group and others may do"""


def cache_folder() -> Path:
    """Return the folder of this user's cache, ``$XDG_CACHE_HOME/diffbot`` or ``~/.cache/diffbot``, made if need be.

    Raises:
        DiffbotError: naming folder, owner and mode, if it is not this user's alone, or cannot be made.
    """
    given = os.environ.get("XDG_CACHE_HOME", "")
    try:
        base = Path(given) if Path(given).is_absolute() else Path.home() / ".cache"
    except RuntimeError:  # a user without a home
        raise DiffbotError("no folder for a cache: set XDG_CACHE_HOME or HOME") from None
    return private_folder(base / _NAME)


@functools.cache
def runtime_folder() -> Path:
    """Return the folder of what exists while programs run: locks, and files that others must not read.

    That is ``$XDG_RUNTIME_DIR/diffbot``, or a part of the cache; if that is not this user's alone, a new one of this
    process, with a line in the log.
    """
    session = Path(os.environ.get("XDG_RUNTIME_DIR", ""))
    try:
        if session.is_absolute() and not _trouble(session):
            return private_folder(session / _NAME)
        return private_folder(cache_folder() / "run")
    except DiffbotError as error:
        logging.getLogger(_NAME).warning("%s", error)
    made = Path(tempfile.mkdtemp(prefix=f"{_NAME}-"))
    atexit.register(shutil.rmtree, made, ignore_errors=True)
    return made


def private_folder(folder: Path) -> Path:
    """Make a folder that only this user can use, or check one; return it.

    A folder of this user that others can read, but not write to, is closed to them.

    Raises:
        DiffbotError: naming folder, owner and mode, if another user owns it or can write to it, or it cannot be made.
    """
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        folder.mkdir(mode=0o700, exist_ok=True)
        if trouble := _trouble(folder):
            raise DiffbotError(f"{folder} is not used: {trouble}")
        if stat.S_IMODE(folder.lstat().st_mode) & _OTHERS:
            folder.chmod(0o700)
    except OSError as error:
        raise DiffbotError(f"{folder} is not used: {error.strerror or error}") from None
    return folder


def _trouble(folder: Path) -> str:
    """Return why what is in a folder is not to be believed; empty if nobody but this user can change it."""
    try:
        found = folder.lstat()
    except OSError as error:
        return error.strerror or str(error)
    if not stat.S_ISDIR(found.st_mode):
        return "it is no folder"
    return not_own(found)


def not_own(found: os.stat_result) -> str:
    """Return whose a file or folder is, or who can change it, if that is not this user alone; else an empty text."""
    if found.st_uid != os.geteuid():
        return f"it belongs to user {found.st_uid}, this is user {os.geteuid()}"
    if found.st_mode & (stat.S_IWGRP | stat.S_IWOTH):
        return f"its mode {stat.S_IMODE(found.st_mode):04o} lets others write to it (chmod go-w)"
    return ""
