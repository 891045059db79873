"""The moving picture docs/docking.gif: one simulated docking, with what the robot sees and what it takes from it."""

from __future__ import annotations

from pathlib import Path

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.animation import PillowWriter
from numpy.typing import NDArray

from diffbot_control.law.docking import Docking
from diffbot_control.law.docking_axis import DockingConfig
from diffbot_core.files import replacing
from diffbot_core.geometry import Pose, out_of_frame
from diffbot_lab.arena.animation import corners
from diffbot_lab.arena.docking.study import CASES, case_of
from diffbot_sim.compiled.batch import Starts, run_histories
from diffbot_sim.model.detector import DetectorConfig, detection_at
from diffbot_sim.model.philox import NoiseKey

START, SEED = (-2.0, 0.45, 0.3), 3
_DOTS, _EVERY = 80, 2
"""[1/inch]; sampling times from frame to frame"""
_SHOWN = 10
"""detections that stay in the picture"""
_BLUE, _ORANGE, _GREY = "#0072b2", "#d55e00", "#999999"


def write_docking_movie(path: Path) -> None:
    """Write the GIF in real time."""
    case = case_of(CASES[0], Docking)
    history = run_histories(case, Starts(np.array([START])), SEED, 0, 1, law=Docking)[0]
    end = int(np.argmax(history[:, 0] >= 0.0)) + 1
    seen = [_seen_dock(case.sensors.detector, history[step], step) for step in range(end)]
    config: DockingConfig = case.controller
    figure, axes = plt.subplots(figsize=(8.0, 3.2), dpi=_DOTS, layout="constrained")
    half = config.corridor * config.approach_length
    axes.fill_between([-config.staging_distance, 0.0], -half, half, color="#cfe8d5", label="corridor")
    axes.plot([-config.staging_distance, 0.0], [0.0, 0.0], color="#339955", linestyle="--", linewidth=1.0, label="axis")
    axes.plot([0.16, 0.16], [-0.12, 0.12], color="black", linewidth=6.0, label="dock")
    (trail,) = axes.plot([], [], color=_BLUE, label="truth")
    (estimate,) = axes.plot([], [], color=_ORANGE, linewidth=1.0, label="estimate")
    (crosses,) = axes.plot([], [], color=_GREY, marker="x", linestyle="", label="detections of the docked pose")
    (body,) = axes.fill([0.0], [0.0], facecolor=_BLUE, edgecolor="white", zorder=20)
    text = axes.text(0.01, 0.92, "", transform=axes.transAxes, family="monospace")
    axes.set(xlim=(-2.2, 0.4), ylim=(-0.4, 0.6), aspect="equal", xlabel="x [m]", ylabel="y [m]")
    axes.legend(loc="upper right", fontsize=8, ncols=3)
    with replacing(path.absolute()) as part:
        file = part.with_suffix(".gif")  # the writer takes the format from it
        writer = PillowWriter(fps=round(1.0 / (_EVERY * case.plant.sampling_time)))
        writer.setup(figure, str(file), _DOTS)
        for step in [*range(0, end, _EVERY), *[end - 1] * 8]:
            trail.set_data(*history[: step + 1, :2].T)
            estimate.set_data(*history[: step + 1, 3:5].T)
            newest = [one for one in seen[: step + 1] if one is not None][-_SHOWN:]
            crosses.set_data(*(np.array(newest).T if newest else ([], [])))
            body.set_xy(corners(history[step, :3], 0.3))
            text.set_text(f"{step * case.plant.sampling_time:4.1f} s")
            writer.grab_frame()
        writer.finish()
        file.replace(part)
    plt.close(figure)


def _seen_dock(detector: DetectorConfig, row: NDArray[np.float64], step: int) -> tuple[float, float] | None:
    """Return where the docked pose was seen [m], by the estimate of that step; None for no detection."""
    found = detection_at(NoiseKey(SEED, 0, step), Pose(*row[:3]), detector)
    if found.lost or not np.isfinite(row[3]):
        return None
    at = out_of_frame(found.pose, Pose(*row[3:6]))
    return at.x, at.y


if __name__ == "__main__":
    write_docking_movie(Path(__file__).with_name("docking.gif"))
