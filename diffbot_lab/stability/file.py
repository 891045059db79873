"""The file of a certificate: one JSON object with all that is needed to check it.

It states the contract, the period, every parameter of the controller, a hash of the law's code, the cells and the
claims. The ranks are 16-bit integers, little endian, in the order of the cells, packed. The plan's margin and fineness
only describe how the cells were chosen.
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
from diffbot_lab.stability.plan import Contract, Plan, check_number, check_plan, requesting

FORMAT = "diffbot stability 5"
_MAX_BYTES = 1_000_000_000
MAX_CELLS = 100_000_000
_MAX_ROWS, _MAX_COLUMNS, _MAX_STEPS = 20_000, 16_000, 32_767


class Claims(NamedTuple):
    """Statement of a certificate."""

    radius: float
    """[m] r*: once in the core, the robot stays within this distance"""
    start: float
    """[m] from every state within this distance ..."""
    steps: int
    """... the robot is in the core after so many steps at most"""
    seed: float
    """[m] Omega_L, once entered, does not last beyond this distance; all states within it are in the core"""


class Certificate(NamedTuple):
    """The contents of a file."""

    plan: Plan
    config: SwitchingConfig
    rho: NDArray[np.float64]
    """(rows + 1,) edges [m]; everything nearer than the first belongs to the core"""
    alphas: NDArray[np.int64]
    """(rows,) even number of equal columns of alpha, -pi to pi; those from 0 on are kept"""
    betas: NDArray[np.int64]
    """(rows,) columns of beta, -pi to pi"""
    ranks: NDArray[np.int16]
    """rank of each cell kept, by row, alpha, beta: 0 in the core, -1 without one"""
    claims: Claims
    law: str
    """hash of the code of the law"""


def first_cells(alphas: NDArray[np.int64], betas: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return (rows + 1,) the index of the first kept cell of each row, and the number of all kept cells."""
    return np.concatenate(([0], np.cumsum(alphas // 2 * betas)))


def save_certificate(path: Path, certificate: Certificate) -> None:
    """Write a certificate.

    Raises:
        OSError: if it cannot be written.
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
    """Read a certificate and check that its parts fit together; what it claims is checked by ``verify``.

    Raises:
        DiffbotError: if the file cannot be read, or a value is missing or out of its range.
    """
    content = _read(path)
    if content.get("format") != FORMAT:
        raise DiffbotError(f"{path}: is no file of the format {FORMAT!r}")
    try:
        return _certificate(content)
    except DiffbotError as error:
        raise DiffbotError(f"{path}: {error}") from None
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise DiffbotError(f"{path}: a value is missing or of the wrong kind: {error}") from None


def _read(path: Path) -> dict[str, Any]:
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


def _certificate(content: dict[str, Any]) -> Certificate:
    values = dict(content["plan"])
    plan = _all_of(Plan, "plan", {**values, "contract": _all_of(Contract, "plan.contract", values["contract"])})
    check_plan(plan)
    config = _config(content["controller"])
    requesting(config, plan)
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
    """Return a tuple of a kind with all of its fields given, and no others."""
    if set(values) != set(kind._fields):
        raise DiffbotError(f"{name}: must have {', '.join(kind._fields)}")
    return kind(**values)


def _config(values: Any) -> SwitchingConfig:
    """Return the configuration; every parameter has to be there: a default of today is not one of the file's."""
    missing = sorted(to_dict(SwitchingConfig()).keys() - dict(values).keys())
    if missing:
        raise DiffbotError(f"controller: without {', '.join(missing)}")
    return build(SwitchingConfig, dict(values))


def _edges(values: Any) -> NDArray[np.float64]:
    if not isinstance(values, list) or not 2 <= len(values) <= _MAX_ROWS + 1:
        raise DiffbotError(f"rho: must be a list of 2 to {_MAX_ROWS + 1} edges")
    for value in values:
        check_number("rho", value, 1e-6, 1e4)
    edges = np.array(values, np.float64)
    falling = np.flatnonzero(~(np.diff(edges) > 0.0))
    if len(falling):
        raise InvalidValueError("rho", float(edges[falling[0] + 1]), f"> {edges[falling[0]]:g}, the edge before it")
    return edges


def _columns(name: str, values: Any, rows: int) -> NDArray[np.int64]:
    if not isinstance(values, list) or len(values) != rows:
        raise DiffbotError(f"{name}: must be a list of {rows} numbers, one for each row of rho")
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
