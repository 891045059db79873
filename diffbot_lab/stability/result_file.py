"""The JSON files of ``diffbot stability``: of bounded size, with the format's name, and packed arrays."""

from __future__ import annotations

import base64
import binascii
import json
import zlib
from pathlib import Path
from typing import Any

from diffbot_core.code_hash import hash_of_code
from diffbot_core.errors import DiffbotError, InvalidValueError

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


def check_number(name: str, value: Any, low: float, high: float) -> None:
    """Refuse what is no number, or out of range.

    Raises:
        InvalidValueError: if it is.
    """
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not low <= value <= high:
        raise InvalidValueError(name, value, f"from {low:g} to {high:g}")


def pack(raw: bytes) -> str:
    """Compress bytes to a text, by zlib and base64."""
    return base64.b64encode(zlib.compress(raw, 9)).decode()


def unpack(name: str, text: Any, size: int) -> bytes:
    """Return what :func:`pack` compressed; no more than ``size`` bytes are ever unpacked.

    Args:
        name: of the field.
        text: its value.
        size: [bytes] to be found.

    Raises:
        DiffbotError: if it is no such text, or of another size.
    """
    if not isinstance(text, str):
        raise DiffbotError(f"{name}: must be a text")
    try:
        raw = zlib.decompressobj().decompress(base64.b64decode(text, validate=True), size + 1)
    except (ValueError, binascii.Error, zlib.error) as error:
        raise DiffbotError(f"{name}: {error}") from None
    if len(raw) != size:
        raise DiffbotError(f"{name}: must hold {size} bytes")
    return raw


def name_of_code() -> str:
    """Return a hash of the code that decides a certificate: what was kept before an interruption is of the same."""
    return hash_of_code(("diffbot_core", "diffbot_control", "diffbot_sim", "diffbot_lab"), ("numba", "numpy"))
