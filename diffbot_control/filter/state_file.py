"""What the filter knows, kept in a file across a restart."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from diffbot_control.filter.covariance import check_covariance
from diffbot_control.filter.ekf import Array
from diffbot_control.filter.localization import Localization
from diffbot_core.errors import BadMessageError, DiffbotError, InvalidValueError
from diffbot_core.files import write_text
from diffbot_core.geometry import MAX_COORDINATE, Pose, wrap_angle
from diffbot_core.kinematics import WheelGeometry

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
    write_text(path, json.dumps(content), durable=True)


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
    x, y, theta = _numbers(path, content, "pose", (3,), MAX_COORDINATE).tolist()
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


class StateKeeper:
    """Keeps what a filter knows in a file."""

    def __init__(self, path: Path, localization: Localization) -> None:
        """Keep the state of ``localization`` at ``path``."""
        self._path = path
        self._localization = localization
        self._saved: int | None = None

    def restore(self, geometry: WheelGeometry) -> str:
        """Start the filter from the file, if there is one; return what was done, for the log.

        The wheels' errors are taken only if they were found with the same ``geometry``.

        Raises:
            BrokenStateError: if the file holds something else; it is set aside under another name.
            DiffbotError: if it cannot be read or set aside.
        """
        try:
            saved = load_state(self._path)
        except BrokenStateError as error:
            # The next saving would write over what is there.
            kept = self._path.with_name(self._path.name + ".bad")
            try:
                self._path.replace(kept)
            except OSError as failure:
                raise DiffbotError(f"cannot rename {self._path}: {failure.strerror or failure}") from None
            raise BrokenStateError(f"{error}; the file is kept as {kept.name}") from None
        if saved is None:
            return "no state to restore"
        self._localization.initialise(saved.pose, saved.P)
        done = "state restored: x {:.3f} m, y {:.3f} m, heading {:.3f} rad".format(*saved.pose)
        if saved.geometry != geometry:
            return f"{done}; wheel errors not restored: found with another wheel radius or separation"
        if saved.wheels is not None and saved.wheels_P is not None:
            self._localization.estimator.set_wheels(saved.wheels, saved.wheels_P)
        return done

    def save(self, geometry: WheelGeometry) -> None:
        """Write what is known, if there is news.

        Raises:
            OSError: if it cannot be written.
        """
        try:
            estimate = self._localization.estimate()
        except BadMessageError:
            return  # nothing is known yet
        if estimate.stamp == self._saved or not np.isfinite(estimate.belief.P).all():
            return
        wheels, wheels_P = self._localization.estimator.wheels() or (None, None)
        save_state(self._path, SavedState(estimate.pose, estimate.P, wheels, wheels_P, geometry))
        self._saved = estimate.stamp

    def forget(self) -> None:
        """Delete the file: what was forgotten must not come back with a restart.

        Raises:
            OSError: if it cannot be deleted.
        """
        self._path.unlink(missing_ok=True)
        self._saved = None
