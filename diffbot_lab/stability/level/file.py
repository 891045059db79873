"""The file of ``diffbot stability level``: one JSON object with all that is needed to check it again."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from diffbot_core.errors import DiffbotError, InvalidValueError
from diffbot_core.files import write_json
from diffbot_lab.stability.level.problem import LevelProblem, Witness
from diffbot_lab.stability.result_file import check_number, pack, read_result, unpack

FORMAT = "diffbot stability level 1"
_MAX_NODES = 200_000_000
_POSITIVE = ("gamma", "k", "h", "t_s")
_MAX_VALUE = 1e4


class LevelCertificate(NamedTuple):
    """What is claimed, and the cells that show it."""

    problem: LevelProblem
    rho_max: float
    """[m]"""
    level: float
    """V decreases in each step above it, for states within ``rho_max``, and stays below once it is"""
    tree: NDArray[np.uint8]
    """(n,) one byte per node in the order of a walk, depth first, lower half first: 0 for a leaf, d + 1 for a node
    halved in dimension d of (rho, alpha, beta, measured alpha, eps_v, eps_omega). So it covers its root by its form."""
    witness: Witness | None
    """A state and a noise with which V does not decrease; None if none was found"""


def save_level(path: Path, certificate: LevelCertificate, notes: Mapping[str, Any]) -> None:
    """Write a certificate; ``notes`` is what nobody needs to check it.

    Raises:
        OSError: if it cannot be written.
    """
    problem, rho_max, level, tree, witness = certificate
    packed = pack(tree.tobytes())
    content = {
        "format": FORMAT,
        "problem": problem._asdict(),
        "rho_max": rho_max,
        "level": level,
        "witness": None if witness is None else witness._asdict(),
        "notes": dict(notes),
        "nodes": len(tree),
        "tree": packed,
    }
    write_json(path, content)


def load_level(path: Path) -> LevelCertificate:
    """Read a certificate and check the ranges of its values; what it claims is checked by ``verify``.

    Raises:
        DiffbotError: if the file cannot be read, or a value is missing or out of its range.
    """
    content = read_result(path)
    if content.get("format") != FORMAT:
        raise DiffbotError(f"{path}: is no file of the format {FORMAT!r}")
    try:
        return _certificate(content)
    except DiffbotError as error:
        raise DiffbotError(f"{path}: {error}") from None


def _certificate(content: dict[str, Any]) -> LevelCertificate:
    values = _part(content, "problem", LevelProblem._fields)
    exact_arc = values.pop("exact_arc")
    if not isinstance(exact_arc, bool):
        raise InvalidValueError("exact_arc", exact_arc, "true or false")
    for name, value in values.items():
        check_number(name, value, 1e-9 if name in _POSITIVE else 0.0, math.pi if name == "eps_theta" else _MAX_VALUE)
    problem = LevelProblem(**{name: float(value) for name, value in values.items()}, exact_arc=exact_arc)
    for name in ("rho_max", "level"):
        check_number(name, content.get(name), 1e-9, _MAX_VALUE**2)
    witness = None
    if content.get("witness") is not None:
        fields = _part(content, "witness", Witness._fields)
        for name, value in fields.items():
            check_number(name, value, -_MAX_VALUE, _MAX_VALUE)
        witness = Witness(**{name: float(value) for name, value in fields.items()})
    rho_max, level = float(content["rho_max"]), float(content["level"])
    return LevelCertificate(problem, rho_max, level, _tree(content), witness)


def _part(content: dict[str, Any], name: str, fields: tuple[str, ...]) -> dict[str, Any]:
    part = content.get(name)
    if not isinstance(part, dict) or sorted(part) != sorted(fields):
        raise DiffbotError(f"{name}: must have the fields {', '.join(fields)}")
    return dict(part)


def _tree(content: dict[str, Any]) -> NDArray[np.uint8]:
    nodes, text = content.get("nodes"), content.get("tree")
    if isinstance(nodes, bool) or not isinstance(nodes, int) or not 0 < nodes <= _MAX_NODES:
        raise InvalidValueError("nodes", nodes, f"a whole number from 1 to {_MAX_NODES}")
    return np.frombuffer(unpack("tree", text, nodes), np.uint8)
