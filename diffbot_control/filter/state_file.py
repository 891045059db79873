"""The filter's state in a file, to survive a restart."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from diffbot_control.filter.belief import ErrorEstimate
from diffbot_control.filter.covariance import check_covariance
from diffbot_control.filter.localization import Localization
from diffbot_control.filter.measurements import Array
from diffbot_core.errors import BadMessageError, DiffbotError
from diffbot_core.files import PRIVATE, write_text
from diffbot_core.foreign_files import read_own
from diffbot_core.geometry import MAX_COORDINATE, Pose, wrap_angle
from diffbot_core.kinematics import WheelGeometry

_VERSION = 1
_MAX_BYTES = 64 * 1024
"""of a file; all errors and their covariances have 2 kB"""
_MAX_RADIUS_ERROR = 1.0
_MAX_LANDMARK_ERROR = 100.0


class BrokenStateError(DiffbotError):
    """A file that does not hold a valid state, or is not this user's own."""


class SavedState(NamedTuple):
    """Pose and radius errors with their covariances."""

    pose: Pose
    P: Array
    """(3, 3) [m, m, rad]"""
    wheels: ErrorEstimate | None
    """None if the filter does not estimate them"""
    geometry: WheelGeometry
    """to which the radius errors are relative"""
    landmarks: ErrorEstimate | None = None
    """the errors that measurements of landmarks have in common; None if the filter does not estimate them"""


def save_state(path: Path, state: SavedState) -> None:
    """Write a state through a temporary file, so that the file is complete at any time.

    Raises:
        OSError: if it cannot be written.
    """
    content: dict[str, Any] = {"version": _VERSION, "pose": list(state.pose), "P": state.P.tolist()}
    content["geometry"] = list(state.geometry)
    if state.wheels is not None:
        content |= {"wheels": state.wheels.errors.tolist(), "wheels_P": state.wheels.P.tolist()}
    if state.landmarks is not None:
        content |= {"landmarks": state.landmarks.errors.tolist(), "landmarks_P": state.landmarks.P.tolist()}
    path.parent.mkdir(parents=True, exist_ok=True)
    write_text(path, json.dumps(content), durable=True, mode=PRIVATE)


def load_state(path: Path) -> SavedState | None:
    """Read a state; None if there is no file.

    Raises:
        BrokenStateError: if it does not hold a valid state, or others could have written it.
    """
    try:
        text = read_own(path, _MAX_BYTES)
        if text is None:
            return None
        content = json.loads(text)
    except DiffbotError as error:
        raise BrokenStateError(str(error)) from None
    except (ValueError, RecursionError):
        raise BrokenStateError(f"{path} is no JSON") from None
    if not isinstance(content, dict) or content.get("version") != _VERSION:
        raise BrokenStateError(f"{path} is no state of version {_VERSION}")
    x, y, theta = _numbers(path, content, "pose", (3,), MAX_COORDINATE).tolist()
    P = _covariance(path, content, "P", 3)
    radius, separation = _numbers(path, content, "geometry", (2,), math.inf).tolist()
    geometry = WheelGeometry(radius, separation)
    wheels = _errors(path, content, "wheels", (2, 3), _MAX_RADIUS_ERROR)
    landmarks = _errors(path, content, "landmarks", (3,), _MAX_LANDMARK_ERROR)
    return SavedState(Pose(x, y, wrap_angle(theta)), P, wheels, geometry, landmarks)


def _errors(
    path: Path, content: dict[str, Any], key: str, sizes: tuple[int, ...], limit: float
) -> ErrorEstimate | None:
    """Return the errors ``key`` (m,) with m one of ``sizes`` and their covariance; None if there are none."""
    if key not in content:
        return None
    found = content[key]
    size = len(found) if isinstance(found, list) and len(found) in sizes else sizes[0]
    errors = _numbers(path, content, key, (size,), limit)
    return ErrorEstimate(errors, _covariance(path, content, f"{key}_P", size))


def _numbers(path: Path, content: dict[str, Any], key: str, shape: tuple[int, ...], limit: float) -> Array:
    try:
        numbers: Array = np.array(content.get(key), dtype=float)
    except (TypeError, ValueError, OverflowError):  # the last one of a whole number beyond the range of floats
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
    """Saves the state of a filter in a file and restores it."""

    def __init__(self, path: Path, localization: Localization) -> None:
        """Use the file ``path`` for the state of ``localization``."""
        self._path = path
        self._localization = localization
        self._saved: int | None = None

    def restore(self, geometry: WheelGeometry) -> str:
        """Initialise the filter from the file, if there is one; return a line for the log.

        The radius errors are restored only if they are relative to the same ``geometry``.

        Raises:
            BrokenStateError: if the file does not hold a valid state; it is renamed.
            DiffbotError: if it cannot be renamed; nothing may be saved then, which would overwrite it.
        """
        try:
            saved = load_state(self._path)
        except BrokenStateError as error:
            # The next save would overwrite it.
            kept = self._path.with_name(self._path.name + ".bad")
            try:
                self._path.replace(kept)
            except OSError as failure:
                raise DiffbotError(f"{error}; it cannot be renamed: {failure.strerror or failure}") from None
            raise BrokenStateError(f"{error}; the file is kept as {kept.name}") from None
        if saved is None:
            return "no state to restore"
        self._localization.initialise(saved.pose, saved.P)
        if saved.landmarks is not None:
            self._localization.filter.set_landmark_errors(saved.landmarks)
        done = "state restored: x {:.3f} m, y {:.3f} m, heading {:.3f} rad".format(*saved.pose)
        if saved.geometry != geometry:
            return f"{done}; wheel errors not restored: found with another wheel radius or separation"
        if saved.wheels is not None:
            self._localization.filter.set_wheels(saved.wheels)
        return done

    def save(self, geometry: WheelGeometry) -> None:
        """Save the present state if it is newer than the saved one.

        Raises:
            OSError: if it cannot be written.
        """
        try:
            estimate = self._localization.estimate()
        except BadMessageError:
            return  # no fix yet
        if estimate.stamp == self._saved or not np.isfinite(estimate.average.P).all():
            return
        found = self._localization.filter
        state = SavedState(estimate.pose, estimate.P, found.wheels(), geometry, found.landmark_errors())
        save_state(self._path, state)
        self._saved = estimate.stamp

    def delete(self) -> None:
        """Delete the file: after a reset, a restart must not restore the old state.

        Raises:
            OSError: if it cannot be deleted.
        """
        self._path.unlink(missing_ok=True)
        self._saved = None
