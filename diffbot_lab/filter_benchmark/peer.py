"""This project's filter beside that of robot_localization: ``diffbot benchmark robot_localization``.

Both get the same messages of the simulated robot, in the order of arrival. The peer is its own code, run by
bench/robot_localization; its process noise and its gate are tuned for each case on other drives, while this project's
filter has its defaults.
"""

from __future__ import annotations

import json
import math
import os
import random
import subprocess
import tempfile
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import stats
from tqdm import tqdm

from diffbot_control.filter.gyro import GyroSample
from diffbot_control.filter.localization import Localization
from diffbot_control.filter.localization_config import LocalizationConfig
from diffbot_control.filter.measurements import Measurement, PoseFix, PositionFix
from diffbot_control.filter.odometry import OdometryStep
from diffbot_control.filter.options import FilterConfig
from diffbot_core.errors import BadMessageError, DiffbotError, InvalidValueError
from diffbot_core.files import output_folder, write_json
from diffbot_core.geometry import wrap_angle
from diffbot_core.kinematics import Twist
from diffbot_core.units import NS_PER_S
from diffbot_lab.filter_benchmark.peer_report import table
from diffbot_sim.model.actuators import ActuatorConfig
from diffbot_sim.model.plant import PlantConfig
from diffbot_sim.model.sensors import SensorConfig
from diffbot_sim.model.simulator import StartPose, World, WorldConfig
from diffbot_sim.reference_loop import measurements_of

Array = NDArray[np.float64]
Results = dict[str, Any]

OURS, DEFAULT, TUNED = "diffbot", "default", "tuned"
DURATION, SKIPPED = 300.0, 30.0
"""[s] of a drive, and at its start what does not count"""
RATE = 50
"""[Hz] of odometry, gyro and the peer's timer"""
TRAINING_SEEDS = (1001, 1002)
"""of the drives that the peer is tuned on"""
_RADIUS = 12.0
"""[m] about the start in which the robot drives"""
_START = NS_PER_S * 1_000_000
"""[ns] a stamp of zero would mean *now* to some"""
_VAR_LATERAL = 1e-6
"""[m^2/s^2] of the lateral velocity, which is zero: so the peer learns of the wheels' constraint"""
_TIMEOUT = 600.0
"""[s] for the peer on one drive"""


class PeerCase(NamedTuple):
    """What differs from the nominal robot."""

    name: str
    text: str
    sensors: SensorConfig
    plant: PlantConfig = PlantConfig()
    filter: FilterConfig = FilterConfig()
    with_heading: bool = True
    """False: fixes measure the position alone"""


_DRIVES = ActuatorConfig(acceleration_max=0.5, angular_acceleration_max=1.5)
_SMOOTH = PlantConfig(actuators=_DRIVES)
_MIX = PlantConfig(
    left_radius_error=0.02,
    actuators=_DRIVES._replace(command_delay=0.1, drive_time_constant=0.1, separation_error=0.03),
)
_LATE = SensorConfig(fix_rate=5.0, fix_delay=0.15)
_GYRO = SensorConfig(fix_rate=1.0, gyro_rate=float(RATE), gyro_error_max=0.005 * math.sqrt(3.0), gyro_bias=0.02)
_GNSS = 0.5 * math.sqrt(3.0)
CASES = (
    PeerCase("nominal", "fixes at 5 Hz", SensorConfig(fix_rate=5.0)),
    PeerCase("late", "fixes 0.3 s late", SensorConfig(fix_rate=5.0, fix_delay=0.3)),
    PeerCase(
        "outliers",
        "5 % of the fixes are 3 m off, all are 0.15 s late",
        _LATE._replace(fix_outlier=0.05, fix_outlier_distance=3.0),
        _SMOOTH,
    ),
    PeerCase(
        "radius",
        "left radius 2 % wrong, fixes at 1 Hz, 0.15 s late",
        _LATE._replace(fix_rate=1.0),
        _SMOOTH._replace(left_radius_error=0.02),
    ),
    PeerCase("mix", "left radius 2 %, separation 3 % wrong; dead time, lag; fixes 0.15 s late", _LATE, _MIX),
    PeerCase(
        "gyro",
        "gyro with a bias of 0.02 rad/s, fixes at 1 Hz, 5 % slip of the right wheel for 100 s",
        _GYRO,
        _SMOOTH._replace(slip_right=0.05, slip_start=100.0, slip_duration=100.0),
        FilterConfig(use_gyro=True),
    ),
    PeerCase(
        "gnss",
        "positions alone, 0.5 m (one deviation), at 1 Hz",
        SensorConfig(fix_rate=1.0, eps_x_max=_GNSS, eps_y_max=_GNSS),
        _SMOOTH,
        with_heading=False,
    ),
)


class Event(NamedTuple):
    """A message and when it arrives."""

    arrival: int
    """[ns]"""
    content: Measurement | OdometryStep | GyroSample


class Drive(NamedTuple):
    """What a filter gets, and where the robot was."""

    events: list[Event]
    truth: Array
    """(n, 3) pose at each step, x, y, yaw [m, m, rad]"""


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


_BEGIN = PeerNoise(1e-4, 1e-4, 0.5, 0.5, 1e9)
_SWEEPS = 2
_GRIDS = (
    ("gate", (4.0, 8.0)),
    ("yaw", (1e-5, 1e-3)),
    ("position", (1e-5, 1e-3, 1e-2)),
    ("omega", (0.05, 5.0)),
    ("v", (0.05, 5.0)),
)
"""What is tried one after the other, the best kept, in each of the sweeps: the budget of the peer."""


def record_drive(case: PeerCase, seed: int, duration: float = DURATION) -> Drive:
    """Drive at random about the start: turns, straights and stops of some seconds each."""
    plant = case.plant._replace(sampling_time=1.0 / RATE)
    rng, events, truth = random.Random(seed), [], []
    start = StartPose(0.0, 0.0, rng.uniform(-math.pi, math.pi))
    world = World(WorldConfig(plant, case.sensors, start, seed), _START)
    until, command = 0.0, Twist(0.0, 0.0)
    for step in range(round(duration * RATE) + 1):
        pose, now = world.state.pose, step / RATE
        if math.hypot(pose.x, pose.y) > _RADIUS:
            back = wrap_angle(math.atan2(-pose.y, -pose.x) - pose.theta)
            command, until = Twist(0.5, max(-0.8, min(0.8, back))), now + 1.0
        elif now >= until:
            until = now + rng.uniform(2.0, 7.0)
            v = 0.0 if rng.random() < 0.15 else rng.uniform(0.2, 1.0)
            command = Twist(v, 0.0 if rng.random() < 0.3 else rng.uniform(-0.8, 0.8))
        events += [Event(world.stamp, one) for one in _messages(world, case.with_heading)]
        truth.append(pose)
        world.advance(command)
    return Drive(events, np.array(truth))


def _messages(world: World, with_heading: bool) -> Iterator[Measurement | OdometryStep | GyroSample]:
    """Yield what arrives at the present step, in the order of the graph."""
    for one in measurements_of(world.sense()):
        if isinstance(one, PoseFix) and not with_heading:
            yield PositionFix(one.stamp, one.pose.x, one.pose.y, one.R[:2, :2])
        else:
            yield one
    reading = world.turn_rate()
    if reading is not None:
        yield GyroSample(*reading)
    yield world.odometry()


def run_ours(case: PeerCase, drive: Drive) -> Estimates:
    """Run this project's filter with its defaults."""
    localization = Localization(LocalizationConfig(filter=case.filter))
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
    return Estimates(_steps_of(np.array(stamps)), np.array(poses), np.array(P), used)


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
    return Estimates(_steps_of(stamps[first]), rows[first, :3], P, float(used)), version


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


def _steps_of(stamps: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the numbers of the steps that the stamps are of."""
    steps: NDArray[np.int64] = np.rint((stamps - _START) * RATE / NS_PER_S).astype(np.int64)
    return steps


class Errors(NamedTuple):
    """Figures of a filter on one drive."""

    position: float
    """[m] root mean square"""
    heading: float
    """[rad] root mean square"""
    nees: float
    """mean"""
    cpu: float
    """[s] of the process for each message of the odometry"""


def errors_of(estimates: Estimates, drive: Drive) -> Errors:
    """Compare estimates with the truth at their stamps."""
    counts = (estimates.steps >= SKIPPED * RATE) & (estimates.steps < len(drive.truth))
    error = estimates.poses[counts] - drive.truth[estimates.steps[counts]]
    error[:, 2] = np.remainder(error[:, 2] + math.pi, 2.0 * math.pi) - math.pi
    P = estimates.P[counts]
    nees = np.einsum("ni,ni->n", error, np.linalg.solve(P, error[..., np.newaxis])[..., 0])
    return Errors(
        math.sqrt(float((error[:, :2] ** 2).sum(axis=1).mean())),
        math.sqrt(float((error[:, 2] ** 2).mean())),
        float(nees.mean()),
        estimates.cpu / len(drive.truth),
    )


def tuned(runner: Path, duration: float, case: PeerCase) -> PeerNoise:
    """Search the peer's noise and gate, one number after the other, for the least error on the training drives."""
    drives = [record_drive(case, seed, duration) for seed in TRAINING_SEEDS]

    def cost(noise: PeerNoise) -> float:
        found = [errors_of(run_peer(runner, case, drive, noise)[0], drive) for drive in drives]
        return sum(one.position + 0.3 * one.heading for one in found)

    return _searched(cost)


def _searched(cost: Callable[[PeerNoise], float]) -> PeerNoise:
    best, least = _BEGIN, cost(_BEGIN)
    for name, values in _GRIDS * _SWEEPS:
        for value in values:
            tried = best._replace(**{name: value})
            if (costs := cost(tried)) < least:
                best, least = tried, costs
    return best


def compared(runner: Path, duration: float, job: tuple[PeerCase, int, PeerNoise]) -> tuple[dict[str, Errors], str]:
    """Run all filters on one drive; return also the peer's version."""
    case, seed, noise = job
    drive = record_drive(case, seed, duration)
    found = {OURS: errors_of(run_ours(case, drive), drive)}
    version = ""
    for name, setting in ((DEFAULT, None), (TUNED, noise)):
        estimates, version = run_peer(runner, case, drive, setting)
        found[name] = errors_of(estimates, drive)
    return found, version


def interval_of(values: list[float]) -> list[float]:
    """Return the mean and its 95 % interval, by Student's t."""
    mean = float(np.mean(values))
    if len(values) < 2:
        return [mean, -math.inf, math.inf]
    half = float(stats.t.ppf(0.975, len(values) - 1) * np.std(values, ddof=1) / math.sqrt(len(values)))
    return [mean, mean - half, mean + half]


def ratio_of(ours: list[float], peers: list[float]) -> list[float]:
    """Return the geometric mean of ours over the peer's on the same drives, with its 95 % interval."""
    logs = [math.log(a / b) for a, b in zip(ours, peers, strict=True)]
    return [math.exp(one) for one in interval_of(logs)]


def figures_of(case: PeerCase, noise: PeerNoise, found: list[dict[str, Errors]]) -> Results:
    """Return the figures of one case."""
    columns = {name: [one[name] for one in found] for name in found[0]}
    return {
        "name": case.name,
        "text": case.text,
        "noise": noise._asdict(),
        "filters": {
            name: {field: interval_of([getattr(one, field) for one in errors]) for field in Errors._fields}
            for name, errors in columns.items()
        },
        "ratio": {
            field: ratio_of(*([getattr(one, field) for one in columns[name]] for name in (OURS, TUNED)))
            for field in ("position", "heading")
        },
    }


def run_benchmark(
    runner: Path, runs: int, seed: int, names: tuple[str, ...] = (), duration: float = DURATION
) -> Results:
    """Tune the peer, then compare, with a progress bar on a terminal; return the content of results.json.

    Args:
        runner: executable of bench/robot_localization.
        runs: drives of each case.
        seed: of the first drive.
        names: of the cases; none for all.
        duration: [s] of a drive.

    Raises:
        InvalidValueError: for an unknown case, or a seed that the peer is tuned on.
        DiffbotError: if the runner fails.
    """
    known = {case.name: case for case in CASES}
    for name in names:
        if name not in known:
            raise InvalidValueError("case", name, "one of " + ", ".join(known))
    seeds = range(seed, seed + runs)
    if set(seeds) & set(TRAINING_SEEDS):
        raise InvalidValueError("seed", seed, f"such that no drive has one of the training seeds {TRAINING_SEEDS}")
    cases = [known[name] for name in names or known]
    with ProcessPoolExecutor(os.cpu_count(), mp_context=get_context("spawn")) as pool:
        try:
            tunings = pool.map(partial(tuned, runner, duration), cases)
            noises = list(tqdm(tunings, desc="tuning", total=len(cases), unit="case", disable=None))
            jobs = [(case, one, noise) for case, noise in zip(cases, noises, strict=True) for one in seeds]
            results = pool.map(partial(compared, runner, duration), jobs)
            done = list(tqdm(results, desc="benchmark", total=len(jobs), unit="drive", disable=None))
        except (KeyboardInterrupt, DiffbotError):
            pool.shutdown(wait=False, cancel_futures=True)
            raise
    return {
        "peer": f"robot_localization {done[0][1]}",
        "runs": runs,
        "seed": seed,
        "training_seeds": TRAINING_SEEDS,
        "duration": duration,
        "skipped": SKIPPED,
        "rate": RATE,
        "cases": [
            figures_of(case, noise, [found for found, _ in done[number * runs : (number + 1) * runs]])
            for number, (case, noise) in enumerate(zip(cases, noises, strict=True))
        ],
    }


def run_and_report(runner: Path, runs: int, seed: int, names: tuple[str, ...], folder: Path) -> int:
    """Run the benchmark, write results.json to ``folder``, and print the table.

    Raises:
        DiffbotError: if the folder cannot be written, a value is not allowed or the runner fails.
    """
    with output_folder(folder):
        results = run_benchmark(runner, runs, seed, names)
        write_json(folder / "results.json", results)
        print(table(results))
    print(f"Results in {folder}")
    return 0
