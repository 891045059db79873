"""``diffbot stability picture``: the change of V at the points of a grid, beside the errors observed in many runs."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from diffbot_control.law.lyapunov_law import Gains
from diffbot_core.files import output_folder, write_json
from diffbot_lab.cases import configure, make_case
from diffbot_lab.stability.picture.figure import draw_picture
from diffbot_lab.stability.picture.grid import evaluate_grid
from diffbot_lab.stability.settings import PAPER_NOISE, NoiseBox, noise_box, refuse_others
from diffbot_sim.compiled.batch import Starts, run_batch
from diffbot_sim.compiled.closed_loop import Case
from diffbot_tools.metrics import quantiles

Array = NDArray[np.float64]

KNOWN = (
    *Gains._fields,
    *("eps_P", "eps_P_leave", "xy_goal_tolerance", "yaw_goal_tolerance", "sampling_time", "exact_arc"),
    *("eps_x_max", "eps_y_max", "eps_theta_max", "eps_v_max", "eps_omega_max", "drive_noise"),
    *("wheel_radius", "wheel_separation"),
)
"""Parameters that the picture covers; it does not cover limits, outliers or slip."""
DURATION = 30.0
"""[s] of each observed run"""
_RUNS_AT_A_TIME = 500_000
_LEVELS = {"median": 0.5, "q99": 0.99, "q99.99": 0.9999}


def run(values: Mapping[str, Any], rho_max: float, number: int, runs: int, seed: int, out: Path) -> int:
    """Evaluate the grid, simulate, and write picture.json and picture.png to ``out``.

    Args:
        values: parameters out of KNOWN, over the paper's noise.
        rho_max: [m] radius of the grid; the runs start in the square inside it.
        number: points of the grid along each axis.
        runs: number of simulated runs.
        seed: of their noise.
        out: folder.

    Raises:
        DiffbotError: for a bad value or an unwritable folder.
    """
    refuse_others(values, KNOWN, "the picture")
    configuration = configure({**PAPER_NOISE, **values})
    plant, sensors, controller, _ = configuration
    box = noise_box(plant, sensors, controller)
    grid = evaluate_grid(controller, box, plant.sampling_time, rho_max, number)
    maps = grid.pop("maps")
    errors = _observe(make_case(configuration, DURATION, feedback="raw"), rho_max, runs, seed)
    observed: dict[str, Any] = {"runs": runs, "seed": seed, "duration": DURATION}
    observed |= {name: quantiles(one, _LEVELS) | {"max": float(one.max())} for name, one in errors.items()}
    with output_folder(out):
        result = {"gains": controller.gains._asdict(), "noise": box._asdict(), "at_grid_points": grid}
        write_json(out / "picture.json", {**result, "only_observed": observed})
        draw_picture(grid, maps, errors, out / "picture.png")
    print(report(grid, observed, box))
    print(f"{out / 'picture.json'}\n{out / 'picture.png'}")
    return 0


def _observe(case: Case, rho_max: float, runs: int, seed: int) -> dict[str, Array]:
    """Simulate runs from all over the grid's square; return their final errors, position [m] and heading [rad]."""
    side = rho_max / math.sqrt(2.0)
    starts = Starts(np.zeros((1, 3)), (side, side, math.pi))
    ends: Array = np.empty((runs, 3))
    for at in range(0, runs, _RUNS_AT_A_TIME):
        some = slice(at, min(at + _RUNS_AT_A_TIME, runs))
        ends[some] = run_batch(case, starts, seed, at, some.stop - at)[:, :3]
    return {"position": np.hypot(ends[:, 0], ends[:, 1]), "abs_theta": np.abs(ends[:, 2])}


def report(grid: dict[str, Any], observed: dict[str, Any], box: NoiseBox) -> str:
    """Lay out what was computed at the points and what was observed, for a terminal."""
    beyond = "" if grid["inside_grid"] else ", which is beyond the grid"
    lines = [
        f"Noise: eps_x {box.eps_x:g} m, eps_y {box.eps_y:g} m, eps_theta {box.eps_theta:g} rad, "
        f"eps_v {box.eps_v:g} m/s, eps_omega {box.eps_omega:g} rad/s, each uniform or not, within these bounds",
        f"At {grid['grid_points']} points (rho, alpha, beta), law (13), for every noise within the bounds:",
        f"  V decreases at {100.0 * grid['share_decreasing']:.1f} % of them, and at all with V > {grid['level']:.3f}, "
        f"a distance of {grid['distance_of_level']:.3f} m{beyond};",
        "  nothing is shown between the points, where V may increase at higher levels (see diffbot stability level)",
        "By algebra, in Omega_L while the robot stays in it:",
        f"  |theta| comes below {grid['heading_bound_local']:.4f} rad",
        f"  eps_P = {grid['eps_P']:g} m against the paper's condition > {grid['radius_condition']:.4f} m: "
        + ("met" if grid["eps_P"] > grid["radius_condition"] else "NOT met"),
        f"Observed, law (17), at the end of {observed['runs']} runs of {observed['duration']:g} s "
        "with raw measurements:",
    ]
    for name, unit in (("position", "m"), ("abs_theta", "rad")):
        one = observed[name]
        lines.append(
            f"  {name}: median {one['median']:.4f}, 99 % {one['q99']:.4f}, "
            f"99.99 % {one['q99.99']:.4f}, max {one['max']:.4f} {unit}"
        )
    return "\n".join(lines)
