"""Read and write the file of a certificate: one JSON object with everything that the checker needs.

The file contains the plan with the contract, all parameters of the controller, a hash of the law's code, the cells and
the claims. The ranks are 16-bit integers, little endian, in the order of the cells, compressed by zlib and encoded as
base64. The checker does not use the plan's margin and fineness, which only document how the cells were chosen.
"""

from __future__ import annotations

import base64
import binascii
import json
import zlib
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from diffbot_control.law.configuration import SwitchingConfig
from diffbot_core.errors import DiffbotError, InvalidValueError
from diffbot_core.files import write_json
from diffbot_core.schema import build, to_dict
from diffbot_lab.stability.plan import Contract, Plan, check_number, check_plan, ideal_law

FORMAT = "diffbot stability 5"
MAX_CELLS = 100_000_000
_MAX_COLUMNS, _MAX_STEPS = 16_000, 32_767


class Claims(NamedTuple):
    """Claims of a certificate."""

    radius: float
    """[m] r*, the largest distance from the goal in the core"""
    start: float
    """[m] largest distance of the starts"""
    steps: int
    """largest number of steps from a start to the core"""
    seed: float
    """[m] seed radius: all states within it are in the core. A robot in Omega_L does not leave it"""


class Certificate(NamedTuple):
    """Contents of the file of a certificate."""

    plan: Plan
    config: SwitchingConfig
    rho: NDArray[np.float64]
    """(rows + 1,) edges [m]; all states nearer than the first edge belong to the core"""
    alphas: NDArray[np.int64]
    """(rows,) number of equal columns of alpha from -pi to pi, even; only columns with alpha >= 0 are stored"""
    betas: NDArray[np.int64]
    """(rows,) number of equal columns of beta from -pi to pi"""
    ranks: NDArray[np.int16]
    """(cells,) rank of each stored cell, ordered by row, alpha and beta: 0 in the core, -1 if the cell has no rank"""
    claims: Claims
    law: str
    """hash of the law's code"""


def first_cells(alphas: NDArray[np.int64], betas: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return (rows + 1,) indices of the first stored cell of each row; the last element is the number of all cells."""
    return np.concatenate(([0], np.cumsum(alphas // 2 * betas)))


def save_certificate(path: Path, certificate: Certificate) -> None:
    """Write a certificate.

    Raises:
        OSError: if the file cannot be written.
    """
    plan, config, rho, alphas, betas, ranks, claims, law = certificate
    content = {
        "format": FORMAT,
        "law": law,
        "claims": claims._asdict(),
        "plan": {**plan._asdict(), "contract": plan.contract._asdict()},
        "controller": to_dict(config),
        "rho": rho.tolist(),
        "alphas": alphas.tolist(),
        "betas": betas.tolist(),
        "ranks": pack(ranks.astype("<i2").tobytes()),
    }
    write_json(path, content)


def load_certificate(path: Path) -> Certificate:
    """Read a certificate and check that its parts have matching sizes. The claims are not checked here.

    Raises:
        DiffbotError: if the file cannot be read, or a value is missing or out of its range.
    """
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise DiffbotError(f"cannot read {path}: {error.strerror}") from None
    except (ValueError, RecursionError):
        raise DiffbotError(f"{path} is not JSON") from None
    if not isinstance(content, dict) or content.get("format") != FORMAT:
        raise DiffbotError(f"{path} is not a certificate with the format {FORMAT!r}; make it again")
    try:
        return _certificate(content)
    except DiffbotError as error:
        raise DiffbotError(f"{path}: {error}") from None
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise DiffbotError(f"{path}: a value is missing or has the wrong type: {error}") from None


def _certificate(content: dict[str, Any]) -> Certificate:
    values = dict(content["plan"])
    plan = _all_of(Plan, "plan", {**values, "contract": _all_of(Contract, "plan.contract", values["contract"])})
    check_plan(plan)
    config = _config(content["controller"])
    ideal_law(config, plan)
    rho = _edges(content["rho"])
    alphas, betas = (_columns(name, content[name], len(rho) - 1) for name in ("alphas", "betas"))
    if (alphas % 2).any():
        raise InvalidValueError("alphas", int(alphas[alphas % 2 == 1][0]), "even")
    cells = int(first_cells(alphas, betas)[-1])
    if cells > MAX_CELLS:
        raise InvalidValueError("cells", cells, f"<= {MAX_CELLS}")
    ranks = np.frombuffer(unpack("ranks", content["ranks"], 2 * cells), "<i2").astype(np.int16)
    if ranks.min(initial=0) < -1:
        raise InvalidValueError("ranks", int(ranks.min()), ">= -1")
    return Certificate(plan, config, rho, alphas, betas, ranks, _claims(content["claims"]), str(content["law"]))


def _all_of(kind: Any, name: str, values: dict[str, Any]) -> Any:
    """Return the named tuple ``kind`` with these values. Missing and additional fields are errors."""
    if set(values) != set(kind._fields):
        raise DiffbotError(f"{name} must have exactly the fields {', '.join(kind._fields)}")
    return kind(**values)


def _config(values: Any) -> SwitchingConfig:
    """Return the configuration. Missing parameters are errors, because a default may have changed."""
    missing = sorted(to_dict(SwitchingConfig()).keys() - dict(values).keys())
    if missing:
        raise DiffbotError(f"controller has no {', '.join(missing)}")
    return build(SwitchingConfig, dict(values))


def _edges(values: Any) -> NDArray[np.float64]:
    if not isinstance(values, list) or len(values) < 2:
        raise DiffbotError("rho must be a list of at least 2 edges")
    for value in values:
        check_number("rho", value, 1e-6, 1e4)
    edges = np.array(values, np.float64)
    falling = np.flatnonzero(~(np.diff(edges) > 0.0))
    if len(falling):
        raise InvalidValueError("rho", float(edges[falling[0] + 1]), f"> {edges[falling[0]]:g}, the previous edge")
    return edges


def _columns(name: str, values: Any, rows: int) -> NDArray[np.int64]:
    if not isinstance(values, list) or len(values) != rows:
        raise DiffbotError(f"{name} must be a list of {rows} numbers, one for each row of rho")
    for value in values:
        if isinstance(value, bool) or not isinstance(value, int) or not 4 <= value <= _MAX_COLUMNS:
            raise InvalidValueError(name, value, f"a whole number from 4 to {_MAX_COLUMNS}")
    return np.array(values, np.int64)


def _claims(values: Any) -> Claims:
    claims = Claims(**values)
    for name in ("radius", "start", "seed"):
        check_number(f"claims.{name}", getattr(claims, name), 0.0, 1e4)
    if isinstance(claims.steps, bool) or not isinstance(claims.steps, int) or not 0 <= claims.steps <= _MAX_STEPS:
        raise InvalidValueError("claims.steps", claims.steps, f"a whole number from 0 to {_MAX_STEPS}")
    return Claims(float(claims.radius), float(claims.start), claims.steps, float(claims.seed))


def pack(raw: bytes) -> str:
    """Compress bytes by zlib and encode them as base64."""
    return base64.b64encode(zlib.compress(raw, 9)).decode()


def unpack(name: str, text: Any, size: int) -> bytes:
    """Return the bytes of a text made by :func:`pack`. At most one byte more than ``size`` is decompressed.

    Args:
        name: name of the field, for errors.
        text: value of the field.
        size: [bytes] expected size.

    Raises:
        DiffbotError: if the text cannot be decoded, or has another size.
    """
    if not isinstance(text, str):
        raise DiffbotError(f"{name} must be a string")
    try:
        raw = zlib.decompressobj().decompress(base64.b64decode(text, validate=True), size + 1)
    except (ValueError, binascii.Error, zlib.error) as error:
        raise DiffbotError(f"{name} cannot be decoded: {error}") from None
    if len(raw) != size:
        raise DiffbotError(f"{name} must contain {size} bytes, two for each cell")
    return raw
