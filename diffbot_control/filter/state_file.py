"""Save the state of the filter in a file, and restore it after a restart."""

from __future__ import annotations

import json
import math
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from diffbot_control.filter.covariance import check_covariance
from diffbot_control.filter.localization import Localization
from diffbot_control.filter.models import SENSOR, WHEELS, Array
from diffbot_control.filter.state import set_errors
from diffbot_core.errors import BadMessageError, DiffbotError
from diffbot_core.files import read_text, write_text
from diffbot_core.geometry import MAX_COORDINATE, Pose, wrap_angle
from diffbot_core.kinematics import WheelGeometry

_VERSION = 1
_MAX_BYTES = 64 * 1024
"""Largest size of a file; a state needs about 2 kB."""
_ERRORS = {"wheels": (WHEELS, 1.0), "landmarks": (SENSOR, 100.0)}
"""Groups of three errors by name: index of the first error in the state, and bound of each error."""


class BrokenStateError(DiffbotError):
    """The file does not contain a valid state."""


class SavedState(NamedTuple):
    """Pose and estimated errors with their covariances."""

    pose: Pose
    P: Array
    """(3, 3) covariance of the pose [m, m, rad]"""
    geometry: WheelGeometry
    """geometry to which the wheel errors are relative"""
    errors: dict[str, tuple[Array, Array]]
    """errors (3,) and their covariance (3, 3) by name (wheels, landmarks); errors that were not estimated have the
    variance 0"""


def save_state(path: Path, state: SavedState) -> None:
    """Write a state; the file is replaced atomically, so it is always complete.

    Raises:
        OSError: if the file cannot be written.
    """
    content: dict[str, Any] = {"version": _VERSION, "pose": list(state.pose), "P": state.P.tolist()}
    content["geometry"] = list(state.geometry)
    for name, (errors, P) in state.errors.items():
        content |= {name: errors.tolist(), f"{name}_P": P.tolist()}
    path.parent.mkdir(parents=True, exist_ok=True)
    write_text(path, json.dumps(content), durable=True)


def load_state(path: Path) -> SavedState | None:
    """Read a state; return None if the file does not exist.

    Raises:
        BrokenStateError: if the file does not contain a valid state.
    """
    try:
        if not path.exists():
            return None
        content = json.loads(read_text(path, _MAX_BYTES))
    except DiffbotError as error:
        raise BrokenStateError(str(error)) from None
    except (ValueError, RecursionError):
        raise BrokenStateError(f"{path} is not a JSON file") from None
    if not isinstance(content, dict) or content.get("version") != _VERSION:
        raise BrokenStateError(f"{path} does not contain a filter state of version {_VERSION}")
    x, y, theta = _numbers(path, content, "pose", (3,), MAX_COORDINATE).tolist()
    geometry = WheelGeometry(*_numbers(path, content, "geometry", (2,), math.inf).tolist())
    errors = {
        name: (_numbers(path, content, name, (3,), bound), _covariance(path, content, f"{name}_P", allow_zero=True))
        for name, (_, bound) in _ERRORS.items()
        if name in content
    }
    return SavedState(Pose(x, y, wrap_angle(theta)), _covariance(path, content, "P"), geometry, errors)


def _numbers(path: Path, content: dict[str, Any], key: str, shape: tuple[int, ...], limit: float) -> Array:
    try:
        numbers: Array = np.array(content.get(key), dtype=float)
    except (TypeError, ValueError, OverflowError):  # OverflowError: an integer beyond the range of floats
        raise BrokenStateError(f"{path}: {key} is not an array of numbers") from None
    if numbers.shape != shape or not np.isfinite(numbers).all() or np.abs(numbers).max() > limit:
        bounds = "" if math.isinf(limit) else f" between {-limit:g} and {limit:g}"
        raise BrokenStateError(f"{path}: {key} must contain {math.prod(shape)} finite numbers{bounds}")
    return numbers


def _covariance(path: Path, content: dict[str, Any], key: str, *, allow_zero: bool = False) -> Array:
    """Return a covariance (3, 3); with ``allow_zero``, variances may be 0."""
    P = _numbers(path, content, key, (3, 3), math.inf)
    part = np.flatnonzero(P.any(axis=0) | P.any(axis=1)) if allow_zero else np.arange(3)
    try:
        check_covariance(P[np.ix_(part, part)])
    except BadMessageError as error:
        raise BrokenStateError(f"{path}: {key}: {error}") from None
    return P


class StateKeeper:
    """Saves the state of a filter in a file and restores it."""

    def __init__(self, path: Path, localization: Localization) -> None:
        """Use the file ``path`` for the state of ``localization``."""
        self._path = path
        self._localization = localization
        self._saved: int | None = None
        self._worker = ThreadPoolExecutor(1, "state")
        self._writing: Future[None] | None = None

    def restore(self, geometry: WheelGeometry) -> str:
        """Initialise the filter from the file if it exists; return a sentence for the log.

        The wheel errors are restored only if they are relative to the same ``geometry``.

        Raises:
            BrokenStateError: if the file does not contain a valid state; the file was renamed.
            DiffbotError: if the invalid file cannot be renamed. Then the caller must not save, since this would
                overwrite the file.
        """
        try:
            saved = load_state(self._path)
        except BrokenStateError as error:
            # Otherwise the next save would overwrite the broken file.
            kept = self._path.with_name(self._path.name + ".bad")
            try:
                self._path.replace(kept)
            except OSError as failure:
                raise DiffbotError(f"{error}; the file cannot be renamed: {failure.strerror or failure}") from None
            raise BrokenStateError(f"{error}; the file is kept as {kept.name}") from None
        if saved is None:
            return "no state to restore"
        self._localization.initialise(saved.pose, saved.P)
        text = "state restored: x {:.3f} m, y {:.3f} m, heading {:.3f} rad".format(*saved.pose)
        for name, (errors, P) in saved.errors.items():
            if name == "wheels" and saved.geometry != geometry:
                text += "; wheel errors not restored: they belong to another wheel radius or separation"
            else:
                set_errors(self._localization.filter, self._localization.options, _ERRORS[name][0], errors, P)
        return text

    def start_save(self, geometry: WheelGeometry) -> None:
        """Start to save the present state in a thread, because a busy disk would delay the poses.

        Raises:
            OSError: if the previous state could not be written.
        """
        if self._writing is not None and not self._writing.done():
            return
        try:
            self._end_save()
        finally:
            self._submit(geometry)

    def save(self, geometry: WheelGeometry) -> None:
        """Save the present state if it is newer than the saved state.

        Raises:
            OSError: if the file cannot be written.
        """
        with suppress(OSError):
            self._end_save()
        self._submit(geometry)
        self._end_save()

    def _end_save(self) -> None:
        """Wait until the last state is written, and raise the error of its writing."""
        writing, self._writing = self._writing, None
        if writing is not None:
            writing.result()

    def _submit(self, geometry: WheelGeometry) -> None:
        try:
            estimate = self._localization.estimate()
        except BadMessageError:
            return  # no fix yet
        x, P = self._localization.filter.x, self._localization.filter.P
        if estimate.stamp == self._saved or not (np.isfinite(x).all() and np.isfinite(P).all()):
            return
        errors = {}
        for name, (first, _) in _ERRORS.items():
            part = slice(first, first + 3)
            if any(self._localization.options.variances[first - WHEELS : first - WHEELS + 3]):
                errors[name] = x[part].copy(), P[part, part].copy()
        state = SavedState(estimate.pose, estimate.P.copy(), geometry, errors)
        self._writing = self._worker.submit(self._write, state, estimate.stamp)

    def _write(self, state: SavedState, stamp: int) -> None:
        save_state(self._path, state)
        self._saved = stamp

    def delete(self) -> None:
        """Delete the file, so that a restart after a reset does not restore the old state.

        Raises:
            OSError: if the file cannot be deleted.
        """
        with suppress(OSError):
            self._end_save()
        self._path.unlink(missing_ok=True)
        self._saved = None
