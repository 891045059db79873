"""The file of a certificate: one JSON object that states the loop, the noise, the cells and the claims, with the ranks.

The ranks are 16-bit integers, little endian, row by row, compressed by zlib and written in base64.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from diffbot_core.errors import DiffbotError, InvalidValueError
from diffbot_core.files import write_json
from diffbot_lab.stability.result_file import check_number, pack, read_result, unpack

Array = NDArray[np.float64]

FORMAT = "diffbot stability certificate 1"
EULER, EXACT_ARC = "Euler", "exact arc"
_MAX_CELLS = 100_000_000
_POSITIVE = ("gamma", "k", "h", "k_2", "t_s")
_FROM_ZERO = ("eps_P", "eps_P_leave", "eps_x", "eps_y", "eps_theta", "eps_v", "eps_omega")


class Loop(NamedTuple):
    """What the certificate is about."""

    gamma: float
    """[m/s]"""
    k: float
    """[1/s]"""
    h: float
    """[-]"""
    k_2: float
    """[1/s]"""
    eps_P: float
    """[m] law (17) enters Omega_L below it; 0 with ``eps_P_leave`` 0: law (13) everywhere"""
    eps_P_leave: float
    """[m] Omega_L is left above it"""
    eps_x: float
    """[m] bounds of the measurement noise ..."""
    eps_y: float
    """[m]"""
    eps_theta: float
    """[rad]"""
    eps_v: float
    """[m/s] ... and of the input noise"""
    eps_omega: float
    """[rad/s]"""
    t_s: float
    """[s]"""
    plant: str
    """EULER or EXACT_ARC"""


class Claims(NamedTuple):
    """What is proved."""

    radius: float
    """[m] r*: the core is within this distance of the goal"""
    start: float
    """[m] every trajectory that starts within this distance, with any heading, ..."""
    steps: int
    """... is in the core after so many steps at most, and stays"""


class Certificate(NamedTuple):
    """The contents of a file."""

    loop: Loop
    rho: Array
    """(rows + 1,) edges [m]; what is nearer than the first belongs to the core"""
    alpha: Array
    """(columns + 1,) edges [rad]"""
    ranks: NDArray[np.int16]
    """(rows, columns)"""
    claims: Claims


def save_certificate(path: Path, certificate: Certificate, notes: dict[str, Any]) -> None:
    """Write a certificate.

    Args:
        path: of the file.
        certificate: to be written.
        notes: what is not needed to check it: rounding, versions, duration.

    Raises:
        OSError: if it cannot be written.
    """
    loop, rho, alpha, ranks, claims = certificate
    content = {
        "format": FORMAT,
        "law": "17" if loop.eps_P_leave > 0.0 else "13",
        "loop": loop._asdict(),
        "claims": claims._asdict() | {"time": claims.steps * loop.t_s},
        "notes": notes,
        "rho": rho.tolist(),
        "alpha": alpha.tolist(),
        "ranks": pack(ranks.astype("<i2").tobytes()),
    }
    write_json(path, content, indent=0)


def load_certificate(path: Path) -> Certificate:
    """Read a certificate and check that its parts fit together; what it claims is checked by ``verify``.

    Raises:
        DiffbotError: if the file cannot be read, or a value is missing or out of its range.
    """
    content = read_result(path)
    if content.get("format") != FORMAT:
        raise DiffbotError(f"{path}: is no {FORMAT}")
    try:
        return _certificate(content)
    except DiffbotError as error:
        raise DiffbotError(f"{path}: {error}") from None
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise DiffbotError(f"{path}: a value is missing or of the wrong kind: {error}") from None


def _certificate(content: dict[str, Any]) -> Certificate:
    loop = _loop(content["loop"])
    rho, alpha = (np.array(content[name], dtype=np.float64) for name in ("rho", "alpha"))
    for name, edges in (("rho", rho), ("alpha", alpha)):
        if edges.ndim != 1 or len(edges) < 2 or not (np.isfinite(edges).all() and (np.diff(edges) > 0.0).all()):
            raise DiffbotError(f"{name}: must be increasing edges")
    rows, columns = len(rho) - 1, len(alpha) - 1
    if rows * columns > _MAX_CELLS:
        raise InvalidValueError("cells", rows * columns, f"<= {_MAX_CELLS}")
    claims = content["claims"]
    steps = claims["steps"]
    if not isinstance(steps, int) or steps < 0:
        raise InvalidValueError("claims.steps", steps, "a whole number >= 0")
    start, radius = float(claims["start"]), float(claims["radius"])
    if not (math.isfinite(start) and math.isfinite(radius)):
        raise DiffbotError("claims: must be finite")
    return Certificate(loop, rho, alpha, _ranks(content["ranks"], rows, columns), Claims(radius, start, steps))


def _loop(values: dict[str, Any]) -> Loop:
    for name in (*_POSITIVE, *_FROM_ZERO):
        check_number(name, values[name], 0.0 if name in _FROM_ZERO else 1e-9, 1e3)
    if values["eps_theta"] > math.pi:
        raise InvalidValueError("eps_theta", values["eps_theta"], "<= pi")
    if values["eps_P_leave"] < values["eps_P"]:
        raise InvalidValueError("eps_P_leave", values["eps_P_leave"], f">= eps_P = {values['eps_P']!r}")
    if values["plant"] not in (EULER, EXACT_ARC):
        raise InvalidValueError("plant", values["plant"], f"{EULER} or {EXACT_ARC}")
    return Loop._make((*(float(values[name]) for name in Loop._fields[:-1]), values["plant"]))


def _ranks(text: Any, rows: int, columns: int) -> NDArray[np.int16]:
    raw = unpack("ranks", text, 2 * rows * columns)
    return np.frombuffer(raw, "<i2").reshape(rows, columns).astype(np.int16)
