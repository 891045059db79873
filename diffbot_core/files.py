"""Output: folders that commands write to, files that are replaced as a whole, JSON."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from diffbot_core.errors import DiffbotError


@contextmanager
def output_folder(folder: Path) -> Iterator[Path]:
    """Create a folder and check it before the work starts; an OSError raised inside becomes a one-line error.

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


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Yield a temporary path in the same folder that replaces ``path`` on success and is removed on failure.

    Readers of ``path`` see the old content or the new one, never a part of either.
    """
    part = path.with_name(f".{path.name}.part")
    try:
        yield part
        os.replace(part, path)
    except BaseException:
        part.unlink(missing_ok=True)
        raise


def write_json(path: Path, content: Any) -> None:
    """Write JSON, replacing ``path`` as a whole; infinities and nan become strings, since JSON has no such numbers.

    Raises:
        OSError: if it cannot be written.
    """
    with replacing(path) as part:
        part.write_text(json.dumps(_finite(content), indent=1, allow_nan=False) + "\n")


def _finite(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _finite(one) for key, one in value.items()}
    if isinstance(value, (list, tuple)):
        return [_finite(one) for one in value]
    return str(value) if isinstance(value, float) and not math.isfinite(value) else value
