"""Folders that no other user of this machine can read or write."""

from __future__ import annotations

import atexit
import os
import shutil
import stat
import tempfile
from functools import cache
from pathlib import Path


@cache
def runtime_folder() -> Path:
    """Return a folder of this user with mode 0700 for files that a process needs while it runs.

    ``$XDG_RUNTIME_DIR/diffbot`` where that is this user's alone, else a new one that goes when this process ends.
    """
    base = Path(os.environ.get("XDG_RUNTIME_DIR", ""))
    folder = base / "diffbot"
    try:
        if base.is_absolute() and _is_private(base):
            folder.mkdir(mode=0o700, exist_ok=True)
            if _is_private(folder):
                return folder
    except OSError:  # missing, or on a disk that is full or read-only
        pass
    folder = Path(tempfile.mkdtemp(prefix="diffbot_"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return folder


def _is_private(folder: Path) -> bool:
    found = folder.lstat()
    return stat.S_ISDIR(found.st_mode) and found.st_uid == os.geteuid() and not found.st_mode & 0o077
