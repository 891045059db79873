"""The figure of ``diffbot stability picture``: maps of the worst dV/dt, and the distribution of observed end states."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from diffbot_tools.plotting import BLUE, ORANGE, RED, new_figure, save

Array = NDArray[np.float64]

_POINTS = 2000
"""Ranks drawn of each curve, evenly spaced on the logarithmic axis."""
_SMALLEST = 1e-5
"""Errors below it are drawn at it."""


def draw_picture(grid: dict[str, Any], maps: dict[str, Array], observed: dict[str, Array], path: Path) -> None:
    """Draw both maps and both curves.

    Args:
        grid: figures of :func:`diffbot_lab.stability.picture.grid.evaluate_grid`.
        maps: its grid ``rho`` (n_rho,) [m] and ``angle`` (n_angle,) [rad], and the worst dV/dt ``over_alpha`` and
            ``over_beta``, (n_rho, n_angle) each.
        observed: errors at the end of the runs, ``position`` [m] and ``abs_theta`` [rad].
        path: of the PNG.

    Raises:
        OSError: if the file cannot be written.
    """
    figure, axes = new_figure(3, (7.5, 10.5), sharex=False)
    for panel, name, other in ((axes[0], "alpha", "beta"), (axes[1], "beta", "alpha")):
        mesh = _draw_map(panel, maps, maps[f"over_{name}"])
        panel.axvline(grid["distance_of_level"], color=ORANGE, linestyle="--", label="highest increase")
        panel.set_ylabel(f"{name} [rad]")
        panel.set_title(f"worst dV/dt over the noise and {other}; blue: V decreases at this point", fontsize="medium")
        panel.legend(fontsize="small")
        figure.colorbar(mesh, ax=panel)
    _draw_tails(axes[2], grid, observed)
    save(figure, path)


def _draw_map(panel: Any, maps: dict[str, Array], rates: Array) -> Any:
    """Draw rates (n_rho, n_angle) over rho (horizontal) and the angle (vertical)."""
    scale = float(np.abs(rates).max())
    grid = maps["rho"], maps["angle"], rates.T
    panel.grid(False)  # which matplotlib 3.6 requires here
    mesh = panel.pcolormesh(*grid, cmap="RdBu_r", norm="symlog", vmin=-scale, vmax=scale, rasterized=True)
    if (rates >= 0.0).any() and (rates < 0.0).any():
        panel.contour(*grid, levels=[0.0], colors="black", linewidths=1.0)
    panel.set_xlabel("rho [m]")
    return mesh


def _draw_tails(axes: Any, grid: dict[str, Any], observed: dict[str, Array]) -> None:
    """Draw the share of runs above each error, with the bound of the heading and the grid's distance."""
    for name, colour, label in (("position", BLUE, "|position| [m]"), ("abs_theta", RED, "|theta| [rad]")):
        values = observed[name]
        ranks = np.unique(np.geomspace(1, len(values), _POINTS).astype(int))
        errors = np.maximum(np.sort(values)[-ranks], _SMALLEST)
        axes.loglog(errors, ranks / len(values), color=colour, label=f"observed {label}")
    heading, distance = grid["heading_bound_local"], grid["distance_of_level"]
    axes.axvline(heading, color=RED, linestyle="--", label="bound of |theta| in Omega_L")
    axes.axvline(distance, color=BLUE, linestyle="--", label="highest increase on the grid, law (13)")
    axes.set_xlim(1e-3, None)
    axes.set_xlabel("error at the end of a run")
    axes.set_ylabel("share of runs above it")
    axes.legend(fontsize="small")
