"""``diffbot stability``: what is proved of the law under noise, beside what many runs show."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from diffbot_control.law.lyapunov_law import Gains
from diffbot_core.errors import DiffbotError, InvalidValueError
from diffbot_core.files import write_json
from diffbot_core.geometry import Pose
from diffbot_lab.campaign.spec import configure
from diffbot_lab.plotting import new_figure, save
from diffbot_lab.stability.certificate import NoiseBox, certify, noise_box
from diffbot_sim.compiled.batch import FEEDBACK_CODES, Starts, run_batch
from diffbot_sim.compiled.closed_loop import Case

Array = NDArray[np.float64]

PAPER_NOISE = {
    "drive_noise": 0.0,
    "eps_v_max": 0.065,
    "eps_omega_max": 0.2167,
    "exact_arc": False,
    "linear.x.max_velocity": math.inf,
}
"""Input noise as the paper adds it, and the law without limits; the measurement noise is the default already."""
KNOWN = (
    *Gains._fields,
    *("eps_P", "eps_P_leave", "xy_goal_tolerance", "yaw_goal_tolerance", "sampling_time", "exact_arc"),
    *("eps_x_max", "eps_y_max", "eps_theta_max", "eps_v_max", "eps_omega_max", "drive_noise"),
    *("wheel_radius", "wheel_separation"),
)
"""Parameters that the certificate takes into account. It knows no limits, outliers, slip and the like."""
_RUNS_AT_A_TIME = 500_000
DURATION = 30.0
"""[s] of each observed run"""


def run(values: Mapping[str, Any], rho_max: float, number: int, runs: int, seed: int, out: Path) -> int:
    """Certify on a grid, observe in runs, and write stability.json and stability.png to ``out``.

    Args:
        values: parameters out of KNOWN, over the paper's noise.
        rho_max: [m] size of the grid, and of the region where the runs begin.
        number: points of the grid along each axis.
        runs: how many to observe.
        seed: of their noise.
        out: folder.

    Raises:
        DiffbotError: for a bad value or an unwritable folder.
    """
    for name, value in values.items():
        if name not in KNOWN:
            raise InvalidValueError(name, value, "left out, the certificate knows only " + ", ".join(KNOWN))
    plant, sensors, controller, _ = configure({**PAPER_NOISE, **values})
    box = noise_box(plant, sensors, controller)
    certified = certify(controller, box, plant.sampling_time, rho_max, number)
    maps = certified.pop("maps")
    case = Case(
        plant,
        sensors,
        controller,
        Pose(0.0, 0.0, 0.0),
        FEEDBACK_CODES["raw"],
        False,
        round(DURATION / plant.sampling_time),
        controller.tolerance.xy_goal_tolerance,
        controller.tolerance.yaw_goal_tolerance,
    )
    side = rho_max / np.sqrt(2.0)
    starts = Starts(np.zeros((1, 3)), (side, side, np.pi))
    ends: Array = np.empty((runs, 3))
    for at in range(0, runs, _RUNS_AT_A_TIME):
        some = slice(at, min(at + _RUNS_AT_A_TIME, runs))
        ends[some] = run_batch(case, starts, seed, at, some.stop - at)[:, :3]
    position, theta = np.hypot(ends[:, 0], ends[:, 1]), np.abs(ends[:, 2])
    observed = {
        "runs": runs,
        "seed": seed,
        "duration": DURATION,
        "position": _extremes(position),
        "abs_theta": _extremes(theta),
    }
    try:
        out.mkdir(parents=True, exist_ok=True)
        result = {"gains": controller.gains._asdict(), "noise": box._asdict(), "proved_at_grid_points": certified}
        write_json(out / "stability.json", {**result, "only_observed": observed})
        _draw(maps, certified, box, position, theta, out / "stability.png")
    except OSError as error:
        raise DiffbotError(f"cannot write to {out}: {error.strerror}") from None
    print(report(certified, observed, box))
    print(f"{out / 'stability.json'}\n{out / 'stability.png'}")
    return 0


def _extremes(values: Array) -> dict[str, float]:
    median, high, higher = np.quantile(values, (0.5, 0.99, 0.9999)).tolist()
    return {"median": median, "q99": high, "q99.99": higher, "max": float(values.max())}


def report(certified: dict[str, Any], observed: dict[str, Any], box: NoiseBox) -> str:
    """Say what is proved and what is only observed."""
    bound = "" if certified["inside_grid"] else " (beyond the grid: not proved, take a larger --rho-max)"
    lines = [
        f"Noise: eps_x {box.eps_x:g} m, eps_y {box.eps_y:g} m, eps_theta {box.eps_theta:g} rad, "
        f"eps_v {box.eps_v:g} m/s, eps_omega {box.eps_omega:g} rad/s, each uniform or not, within these bounds",
        f"Proved at {certified['grid_points']} points (rho, alpha, beta), law (13), for every noise within the bounds:",
        f"  V decreases at {100.0 * certified['share_decreasing']:.1f} % of them, "
        f"and at all with V > {certified['level']:.3f};",
        f"  once V is below {certified['ultimate_level']:.3f} it stays there: distance at most "
        f"{certified['ultimate_distance']:.3f} m{bound}",
        "Proved by algebra, in Omega_L while the robot stays in it:",
        f"  |theta| comes below {certified['heading_bound_local']:.4f} rad",
        f"  eps_P = {certified['eps_P']:g} m against the paper's condition > {certified['radius_condition']:.4f} m: "
        + ("met" if certified["eps_P"] > certified["radius_condition"] else "NOT met"),
        f"Only observed, law (17), at the end of {observed['runs']} runs of {observed['duration']:g} s "
        "with raw measurements:",
    ]
    for name, unit in (("position", "m"), ("abs_theta", "rad")):
        one = observed[name]
        lines.append(
            f"  {name}: median {one['median']:.4f}, 99 % {one['q99']:.4f}, "
            f"99.99 % {one['q99.99']:.4f}, max {one['max']:.4f} {unit}"
        )
    return "\n".join(lines)


def _draw(
    maps: dict[str, Array], certified: dict[str, Any], box: NoiseBox, position: Array, theta: Array, path: Path
) -> None:
    figure, axes = new_figure(3, (7.5, 10.5), sharex=False)
    for panel, key, label in ((axes[0], "over_alpha", "alpha"), (axes[1], "over_beta", "beta")):
        rates = maps[key].T
        scale = float(np.abs(rates).max())
        mesh = panel.pcolormesh(
            maps["rho"], maps["angle"], rates, cmap="RdBu_r", norm="symlog", vmin=-scale, vmax=scale, rasterized=True
        )
        if (rates >= 0.0).any() and (rates < 0.0).any():
            panel.contour(maps["rho"], maps["angle"], rates, levels=[0.0], colors="black", linewidths=1.0)
        panel.axvline(certified["ultimate_distance"], color="#E69F00", linestyle="--", label="ultimate bound")
        panel.set_xlabel("rho [m]")
        panel.set_ylabel(f"{label} [rad]")
        other = "beta" if label == "alpha" else "alpha"
        panel.set_title(f"worst dV/dt over the noise and {other}; blue: V decreases for certain", fontsize="medium")
        panel.legend(fontsize="small")
        figure.colorbar(mesh, ax=panel)
    for values, colour, label in (
        (position, "#0072B2", "|position| [m]"),
        (theta, "#D55E00", "|theta| [rad]"),
    ):
        # Ranks from the largest down, as close as can be seen on a logarithmic axis.
        ranks = np.unique(np.geomspace(1, len(values), 2000).astype(int))
        axes[2].loglog(
            np.maximum(np.sort(values)[-ranks], 1e-5), ranks / len(values), color=colour, label=f"observed {label}"
        )
    axes[2].axvline(
        certified["heading_bound_local"], color="#D55E00", linestyle="--", label="proved |theta| in Omega_L"
    )
    axes[2].axvline(certified["ultimate_distance"], color="#0072B2", linestyle="--", label="proved distance, law (13)")
    axes[2].set_xlim(1e-3, None)
    axes[2].set_xlabel("at the end of a run")
    axes[2].set_ylabel("share of runs above")
    axes[2].legend(fontsize="small")
    save(figure, path)
