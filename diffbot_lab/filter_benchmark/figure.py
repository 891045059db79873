"""The figure of the filter's benchmark: one faulty run of each variant, and the errors of all cases."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from diffbot_control.filter.options import CALIBRATING, EKF, FILTERS, FNN, FNN_CALIBRATING
from diffbot_lab.filter_benchmark.cases import RATES
from diffbot_tools.plotting import new_grid, save

Array = NDArray[np.float64]

_COLOURS = {EKF: "#999999", CALIBRATING: "#0072B2", FNN: "#E69F00", FNN_CALIBRATING: "#009E73"}
_LABELS = {  # the scenarios that are drawn
    "nominal": "right\nmodel",
    "radius": "radius\n+2 %",
    "r_10": "R x 10",
    "r_01": "R x 0.1",
    "outliers": "out-\nliers",
    "slip": "slip",
    "kidnapped": "kid-\nnapped",
    "all": "all at\nonce",
    "compass": "com-\npass",
    "landmarks": "land-\nmarks",
}


def draw_localization(results: dict[str, Any], histories: dict[str, Array], t_s: float, path: Path) -> None:
    """Draw position errors over time with three standard deviations of each filter, and its RMSE in each case.

    Args:
        results: of the benchmark.
        histories: (steps + 1, 4) of one faulty run of each of FILTERS, columns position error, heading error and the
            standard deviations that the filter reports [m, rad, m, rad].
        t_s: sampling time of these runs [s].
        path: of the PNG.

    Raises:
        OSError: if the file cannot be written.
    """
    figure, panels, bars = new_grid(len(FILTERS), len(RATES), (15.0, 7.8), left=0.06)
    for axes, name in zip(panels, FILTERS, strict=True):
        _draw_run(axes, name, histories[name], t_s)
    for axes in panels[1:]:
        axes.tick_params(labelleft=False)
    panels[0].set_ylabel("error of position [m]\nall faults at once, 10/5 Hz")
    for axes, rates in zip(bars, RATES, strict=True):
        _draw_bars(axes, results, rates)
    for axes in bars[1:]:
        axes.tick_params(labelleft=False)
    bars[0].set_ylabel("RMSE of position [m]\nall runs")
    handles, labels = bars[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="lower center", ncols=len(FILTERS), fontsize="small")
    save(figure, path)


def _draw_run(axes: Any, name: str, history: Array, t_s: float) -> None:
    time = t_s * np.arange(len(history))
    axes.fill_between(time, 1e-3, 3.0 * history[:, 2], color=_COLOURS[name], alpha=0.3, label="3 sigma of the filter")
    axes.plot(time, history[:, 0], color="black", linewidth=0.8, label="error")
    axes.set_yscale("log")
    axes.set_ylim(4e-3, 6.0)
    axes.set_xlim(0.0, time[-1])
    axes.set_title(name, fontsize="medium")
    axes.set_xlabel("time [s]")
    axes.tick_params(labelsize="small")
    axes.legend(loc="upper left", fontsize="x-small")


def _draw_bars(axes: Any, results: dict[str, Any], rates: tuple[int, int]) -> None:
    shown = [one for one in results["cases"] if one["scenario"] in _LABELS]
    cases = [one for one in shown if (one["odometry_rate"], one["fix_rate"]) == rates]
    places = np.arange(len(cases))
    width = 0.8 / len(FILTERS)
    for index, name in enumerate(FILTERS):
        values = [one["filters"][name]["position"]["rmse"] for one in cases]
        at = places + (index - 0.5 * (len(FILTERS) - 1)) * width
        axes.bar(at, values, width, color=_COLOURS[name], label=name)
    axes.set_yscale("log")
    axes.set_ylim(0.01, 2.0)
    axes.set_xticks(places, [_LABELS[one["scenario"]] for one in cases], fontsize="x-small")
    text = f"odometry {rates[0]} Hz, fixes {rates[1]} Hz"
    axes.text(0.02, 0.95, text, transform=axes.transAxes, verticalalignment="top")
