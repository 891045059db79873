"""The file of a certificate of the tuned law: configuration, contract, plan, and the rank of each cell.

The ranks are 16-bit integers, little endian, in the order of the cells, packed.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from diffbot_control.law.configuration import ControllerConfig
from diffbot_core.errors import DiffbotError
from diffbot_core.files import write_json
from diffbot_core.schema import build, to_dict
from diffbot_lab.stability.result_file import pack, read_result, unpack
from diffbot_lab.stability.tuned.certify import Certificate, Contract, Plan, check_plan, table_of, tuned_loop
from diffbot_lab.stability.tuned.near import near_bounds

FORMAT = "diffbot stability tuned 1"


def save_tuned(path: Path, certificate: Certificate) -> None:
    """Write a certificate.

    Raises:
        OSError: if it cannot be written.
    """
    content = {
        "format": FORMAT,
        "plan": {**certificate.plan._asdict(), "contract": certificate.plan.contract._asdict()},
        "controller": to_dict(certificate.config),
        "ranks": pack(certificate.ranks.astype("<i2").tobytes()),
    }
    write_json(path, content)


def load_tuned(path: Path) -> Certificate:
    """Read a certificate; its claims are not checked yet.

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
    except (KeyError, TypeError, ValueError) as error:
        raise DiffbotError(f"{path}: a value is missing or of the wrong kind: {error}") from None


def _certificate(content: dict[str, Any]) -> Certificate:
    values = dict(content["plan"])
    plan = Plan(**{**values, "contract": Contract(**values["contract"])})
    check_plan(plan)
    config = build(ControllerConfig, dict(content["controller"]))
    loop = tuned_loop(config, plan.contract)
    near = near_bounds(loop, config, plan.contract.eps_xy, plan.contract.sigma_max)
    table, _ = table_of(loop, near, plan)
    raw = unpack("ranks", content.get("ranks"), 2 * int(table.start[-1]))
    return Certificate(plan, config, near, table, np.frombuffer(raw, "<i2").astype(np.int16))
