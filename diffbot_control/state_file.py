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
from diffbot_control.errors import DiffbotError, InvalidValueError
from diffbot_control.geometry import FARTHEST, Pose, wrap_angle
from diffbot_control.kinematics import WheelGeometry

_VERSION = 1
_WORST = 1.0


class BrokenStateError(DiffbotError):
    """A file that can be read and holds no state."""


class SavedState(NamedTuple):
    """Pose and wheels with their covariances."""

    pose: Pose
    P: Array
    """(3, 3) [m, m, rad]"""
    wheels: Array | None
    """(2,) relative radius errors left, right; None if the filter does not estimate them"""
    wheels_P: Array | None
    """(2, 2)"""
    geometry: WheelGeometry
    """for which the wheels' errors were found"""


def state_path(text: str) -> Path | None:
    """Return the path of the state file, ``~`` unfolded; None for an empty text.

    Raises:
        InvalidValueError: if it cannot be the path of a file.
    """
    if not text:
        return None
    try:
        path = Path(text).expanduser()
        usable = bool(path.name) and "\0" not in text and not path.is_dir()
    except (OSError, RuntimeError, ValueError):
        usable = False
    if not usable:
        raise InvalidValueError("state_file", text, "the path of a file")
    return path


def save_state(path: Path, state: SavedState) -> None:
    """Write a state through a temporary file, so that there is always a whole one.

    Raises:
        OSError: if it cannot be written.
    """
    content: dict[str, Any] = {"version": _VERSION, "pose": list(state.pose), "P": state.P.tolist()}
    content["geometry"] = list(state.geometry)
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
        BrokenStateError: if it holds something else, saying what.
        DiffbotError: if it cannot be read.
    """
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        return None
    except OSError as error:
        raise DiffbotError(f"cannot read {path}: {error.strerror}") from None
    except (ValueError, RecursionError):
        raise BrokenStateError(f"{path} is no JSON") from None
    if not isinstance(content, dict) or content.get("version") != _VERSION:
        raise BrokenStateError(f"{path} is no state of version {_VERSION}")
    x, y, theta = _numbers(path, content, "pose", (3,), FARTHEST).tolist()
    P = _covariance(path, content, "P", 3)
    radius, separation = _numbers(path, content, "geometry", (2,), math.inf).tolist()
    geometry = WheelGeometry(radius, separation)
    if "wheels" not in content:
        return SavedState(Pose(x, y, wrap_angle(theta)), P, None, None, geometry)
    wheels = _numbers(path, content, "wheels", (2,), _WORST)
    return SavedState(Pose(x, y, wrap_angle(theta)), P, wheels, _covariance(path, content, "wheels_P", 2), geometry)


def _numbers(path: Path, content: dict[str, Any], key: str, shape: tuple[int, ...], limit: float) -> Array:
    try:
        numbers: Array = np.array(content.get(key), dtype=float)
    except (TypeError, ValueError):
        raise BrokenStateError(f"{path}: {key} holds no numbers") from None
    if numbers.shape != shape or not np.isfinite(numbers).all() or np.abs(numbers).max() > limit:
        raise BrokenStateError(f"{path}: {key} must be {math.prod(shape)} finite numbers up to {limit:g}")
    return numbers


def _covariance(path: Path, content: dict[str, Any], key: str, size: int) -> Array:
    matrix = _numbers(path, content, key, (size, size), math.inf)
    try:
        return check_covariance(matrix)
    except DiffbotError as error:
        raise BrokenStateError(f"{path}: {key}: {error}") from None
