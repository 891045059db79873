"""``diffbot stability certify --robot``: contract of a robot from its own simulation, then its certificate."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from tqdm import tqdm

from diffbot_core.errors import DiffbotError
from diffbot_lab.stability.certificates import certify_and_save
from diffbot_lab.stability.contract.command import SEED, farthest_start, observe, runs_of_robot
from diffbot_lab.stability.contract.kept import Kept, fitted, kept, share_of
from diffbot_lab.stability.file import Certificate
from diffbot_lab.stability.plan import SLOPES, Contract, Plan
from diffbot_tools.robot.robot import read_robot

_RUNS = 200
"""for the bounds, and as many others to count how often they are kept"""
_SHARE = 1.0
"""of these runs, which keep each bound"""
_END = 45.0
"""[s] end of what is looked at; later the robots stand at their goals"""


def certify_robot(
    name: str, bounds: Mapping[str, float], since: float, cells: Mapping[str, Any], out: Path, threads: int | None
) -> tuple[Certificate, Kept]:
    """Measure the bounds that are not given, certify, and say how often the contract is kept in other runs.

    Args:
        name: parameter file, or a preset's.
        bounds: of the contract, by their names.
        since: [s] the contract is measured from then on in runs that start at rest.
        cells: ``margin`` and ``fineness`` of the plan, if they are given.
        out: file of the certificate.
        threads: at a time; None: one per core.

    Returns:
        The certificate, and the share of the other runs.

    Raises:
        DiffbotError: if the robot is not covered, or there is no certificate.
    """
    robot = read_robot(name)
    runs = runs_of_robot(robot, _RUNS, SEED)
    t_s, steps = runs.case.plant.sampling_time, len(runs.starts)
    part = slice(round(since / t_s), round(_END / t_s) + 1)
    slopes = {name: value for name, value in bounds.items() if name in SLOPES}
    contract = Contract(wheel_error=runs.case.plant.drive_noise, **slopes)
    with tqdm(total=2 * steps, desc="contract", unit="run", disable=None) as bar:
        found = fitted(observe(runs, contract, SEED, bar)[:, part], contract, _SHARE)
        unbounded = [one for one, value in found.items() if not value < 1.0 and one not in bounds]
        if unbounded:
            raise DiffbotError(
                f"no contract: {', '.join(unbounded)} has no bound from {since:g} s on; take a later --since"
            )
        contract = Contract(**{**contract._asdict(), **found, **bounds})
        others = observe(runs_of_robot(robot, _RUNS, SEED + 1), contract, SEED + 1, bar)
    share = share_of(kept(others[:, part], contract))
    plan = Plan(contract, t_s, farthest_start(robot), **cells)
    try:
        certificate = certify_and_save(runs.case.controller, plan, out, threads)
    except DiffbotError as error:
        bounds_kept = ", ".join(f"{name} {value:g}" for name, value in contract._asdict().items())
        raise DiffbotError(f"{error}; contract from {since:g} s on: {bounds_kept}") from None
    print(
        f"In {100.0 * share.runs:.1f} % [{100.0 * share.low:.1f}, {100.0 * share.high:.1f}] of {steps} other runs the "
        f"contract is kept from {since:g} s to {_END:g} s."
    )
    return certificate, share
