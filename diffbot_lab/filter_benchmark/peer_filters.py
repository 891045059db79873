"""Both filters of the comparison over a drive: this project's, and robot_localization's by its runner."""

from __future__ import annotations

import json
import math
import subprocess
import tempfile
import time
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from diffbot_control.filter.gyro import GyroSample
from diffbot_control.filter.localization import Localization
from diffbot_control.filter.localization_config import LocalizationConfig
from diffbot_control.filter.measurements import PoseFix, PositionFix
from diffbot_control.filter.odometry import OdometryStep
from diffbot_core.errors import BadMessageError, DiffbotError
from diffbot_lab.filter_benchmark.peer_drives import RATE, Array, Drive, Event, PeerCase, steps_of

_VAR_LATERAL = 1e-6
"""[m^2/s^2] of the lateral velocity, which is zero: so the peer learns that the wheels do not move sideways"""
_TIMEOUT = 600.0
"""[s] for the peer on one drive"""


class Estimates(NamedTuple):
    """What a filter says of a drive, each stamp once."""

    steps: NDArray[np.int64]
    """(n,) numbers of the steps"""
    poses: Array
    """(n, 3)"""
    P: Array
    """(n, 3, 3)"""
    cpu: float
    """[s]"""


class PeerNoise(NamedTuple):
    """What is tuned of the peer: variances per second of its states, and its gate."""

    position: float
    """[m^2/s]"""
    yaw: float
    """[rad^2/s]"""
    v: float
    """[m^2/s^3]"""
    omega: float
    """[rad^2/s^3]"""
    gate: float
    """Mahalanobis distance beyond which a fix is rejected"""


def run_ours(case: PeerCase, drive: Drive) -> Estimates:
    """Run this project's filter with its defaults."""
    localization = Localization(LocalizationConfig(filter=case.filter), landmarks=bool(case.landmarks.landmark_ids))
    stamps, poses, P = [], [], []
    begin = time.process_time()
    for _, content in drive.events:
        try:
            if isinstance(content, OdometryStep):
                estimate = localization.on_odometry(content)
                stamps.append(content.stamp)
                poses.append(estimate.pose)
                P.append(estimate.P)
            elif isinstance(content, GyroSample):
                localization.on_gyro(content)
            else:
                localization.on_measurement(content)
        except BadMessageError:
            continue  # before the first fix
    used = time.process_time() - begin
    return Estimates(steps_of(np.array(stamps)), np.array(poses), np.array(P), used)


def run_peer(runner: Path, case: PeerCase, drive: Drive, noise: PeerNoise | None) -> tuple[Estimates, str]:
    """Run the peer, with its default noise for None; return also its version.

    Raises:
        DiffbotError: if the runner fails.
    """
    with tempfile.TemporaryDirectory() as folder:
        given, found, settings = (Path(folder, name) for name in ("drive.csv", "estimates.csv", "settings.yaml"))
        given.write_text("".join(f"{line}\n" for line in map(_line, drive.events)))
        settings.write_text(json.dumps(peer_settings(case, noise)))
        command = [str(one) for one in (runner, given, found, "--ros-args", "--params-file", settings)]
        try:
            done = subprocess.run(command, capture_output=True, text=True, timeout=_TIMEOUT, check=False)
        except (OSError, subprocess.TimeoutExpired) as error:
            raise DiffbotError(f"runner: {error}") from error
        said = done.stderr.strip().splitlines() or ["nothing"]
        if done.returncode != 0:
            raise DiffbotError(f"runner: {runner} ended with {done.returncode}: {said[-1]}")
        version, used = said[-1].split()
        stamps = np.loadtxt(found, delimiter=",", usecols=0, dtype=np.int64)
        rows = np.loadtxt(found, delimiter=",", usecols=range(1, 10))
    _, first = np.unique(stamps, return_index=True)
    xx, xy, xt, yy, yt, tt = rows[first, 3:].T
    P = np.moveaxis(np.array(((xx, xy, xt), (xy, yy, yt), (xt, yt, tt))), 2, 0)
    return Estimates(steps_of(stamps[first]), rows[first, :3], P, float(used)), version


def _line(event: Event) -> str:
    """Return a message as the runner reads it."""
    content: Any = event.content
    if isinstance(content, OdometryStep):
        numbers = ["odom", content.stamp, *content.twist, *content.covariance, _VAR_LATERAL]
    elif isinstance(content, GyroSample):
        numbers = ["imu", *content]
    elif isinstance(content, PoseFix):
        numbers = ["pose", content.stamp, *content.pose, *np.diag(content.R).tolist()]
    elif isinstance(content, PositionFix):
        numbers = ["pose", content.stamp, content.x, content.y, 0.0, *np.diag(content.R).tolist(), math.pi**2]
    else:
        raise TypeError(f"no message for the peer: {content}")
    return ",".join(str(one) for one in [event.arrival, *numbers])


def peer_settings(case: PeerCase, noise: PeerNoise | None) -> dict[str, Any]:
    """Return the peer's parameters: a planar robot that fuses late messages, with ``noise`` or its defaults."""
    pose, twist, rate = ([False] * 15 for _ in range(3))
    pose[0] = pose[1] = True
    pose[5] = case.with_heading
    twist[6] = twist[7] = twist[11] = True
    rate[11] = True
    settings: dict[str, Any] = {
        "frequency": float(RATE),
        "sensor_timeout": 2.0 / RATE,
        "two_d_mode": True,
        "publish_tf": False,
        "world_frame": "map",
        "smooth_lagged_data": True,
        "history_length": LocalizationConfig().history_length,
        "odom0": "odom",
        "odom0_config": twist,
        "pose0": "global_pose",
        "pose0_config": pose,
        # By default the pose at the start is taken for zero, and a gate then rejects every fix.
        "initial_estimate_covariance": [100.0, 100.0, *[1e-9] * 3, math.pi**2, *[1e-9] * 9],
    }
    if case.sensors.gyro_rate > 0.0:
        settings |= {"imu0": "imu", "imu0_config": rate}
    if noise is not None:
        xy, yaw, v, omega, gate = noise
        other = 1e-3
        settings["process_noise_covariance"] = [
            *(xy, xy, other, other, other, yaw),
            *(v, other, other, other, other, omega),
            *(1e-2, 1e-2, 1e-2),
        ]
        settings["pose0_rejection_threshold"] = gate
    return {"ekf_filter_node": {"ros__parameters": settings}}
