"""Reads the JSON files of ``diffbot stability``: their size is bounded, their format is named in the file."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from diffbot_core.errors import DiffbotError

_MAX_BYTES = 1_000_000_000


def read_result(path: Path) -> dict[str, Any]:
    """Return the fields of a result.

    Raises:
        DiffbotError: if it cannot be read or is no JSON object.
    """
    try:
        if path.stat().st_size > _MAX_BYTES:
            raise DiffbotError(f"{path}: larger than {_MAX_BYTES} bytes")
        content = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise DiffbotError(f"cannot read {path}: {error.strerror}") from None
    except (ValueError, RecursionError):
        raise DiffbotError(f"{path}: is no JSON") from None
    if not isinstance(content, dict):
        raise DiffbotError(f"{path}: is no JSON object")
    return content
