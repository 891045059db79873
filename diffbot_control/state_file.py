"""What the filter knows, kept in a file across a restart."""

from __future__ import annotations

import json
import math
import os
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from diffbot_control.covariance import check_covariance
from diffbot_control.ekf import Array
from diffbot_control.errors import DiffbotError
from diffbot_control.geometry import Pose, wrap_angle

_VERSION = 1
_FARTHEST = 1e7
_WORST = 0.5


class SavedState(NamedTuple):
    """Pose and wheels with their covariances."""

    pose: Pose
    P: Array
    """(3, 3) [m, m, rad]"""
    wheels: Array | None
    """(2,) relative radius errors left, right; None if the filter does not estimate them"""
    wheels_P: Array | None
    """(2, 2)"""


def save_state(path: Path, state: SavedState) -> None:
    """Write a state through a temporary file, so that there is always a whole one.

    Raises:
        OSError: if it cannot be written.
    """
    content: dict[str, Any] = {"version": _VERSION, "pose": list(state.pose), "P": state.P.tolist()}
    if state.wheels is not None and state.wheels_P is not None:
        content |= {"wheels": state.wheels.tolist(), "wheels_P": state.wheels_P.tolist()}
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(f"{path.name}.{os.getpid()}.tmp")
    try:
        with temporary.open("w", encoding="utf-8") as file:
            json.dump(content, file)
            file.flush()
            os.fsync(file.fileno())
        temporary.replace(path)
    except OSError:
        temporary.unlink(missing_ok=True)
        raise


def load_state(path: Path) -> SavedState | None:
    """Read a state; None if there is no file.

    Raises:
        DiffbotError: if the file cannot be read or holds something else, saying what.
    """
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        return None
    except OSError as error:
        raise DiffbotError(f"cannot read {path}: {error.strerror}") from None
    except (ValueError, RecursionError):
        raise DiffbotError(f"{path} is no JSON") from None
    if not isinstance(content, dict) or content.get("version") != _VERSION:
        raise DiffbotError(f"{path} is no state of version {_VERSION}")
    x, y, theta = _numbers(path, content, "pose", (3,), _FARTHEST).tolist()
    P = _covariance(path, content, "P", 3)
    if "wheels" not in content:
        return SavedState(Pose(x, y, wrap_angle(theta)), P, None, None)
    wheels = _numbers(path, content, "wheels", (2,), _WORST)
    return SavedState(Pose(x, y, wrap_angle(theta)), P, wheels, _covariance(path, content, "wheels_P", 2))


def _numbers(path: Path, content: dict[str, Any], key: str, shape: tuple[int, ...], limit: float) -> Array:
    try:
        numbers: Array = np.array(content.get(key), dtype=float)
    except (TypeError, ValueError):
        raise DiffbotError(f"{path}: {key} holds no numbers") from None
    if numbers.shape != shape or not np.isfinite(numbers).all() or np.abs(numbers).max() > limit:
        raise DiffbotError(f"{path}: {key} must be {math.prod(shape)} finite numbers up to {limit:g}")
    return numbers


def _covariance(path: Path, content: dict[str, Any], key: str, size: int) -> Array:
    matrix = _numbers(path, content, key, (size, size), math.inf)
    try:
        return check_covariance(matrix)
    except DiffbotError as error:
        raise DiffbotError(f"{path}: {key}: {error}") from None
