"""Compare the variants of the filter on the same simulated drives: ``diffbot benchmark localization``.

Run i of each case drives the same arc with the same noise for all variants. The drives are open-loop, because with a
controller the path would depend on the errors of the filter.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri
from tqdm import tqdm

from diffbot_control.filter import ekf
from diffbot_control.filter.config import (
    CALIBRATING,
    EKF,
    FILTERS,
    FNN,
    FNN_CALIBRATING,
    FilterConfig,
    LandmarkMap,
    LocalizationConfig,
)
from diffbot_control.filter.state import NIS, OUTCOME
from diffbot_core.files import output_folder, write_json
from diffbot_core.geometry import Pose, wrap_angle
from diffbot_core.kinematics import Twist
from diffbot_lab.cases import described
from diffbot_lab.tables import number
from diffbot_sim.batch import in_threads
from diffbot_sim.config import PlantConfig, SensorConfig, WorldConfig
from diffbot_sim.fusion import SimulatedRobot, arriving_pose, new_buffers, reference_to
from diffbot_sim.jit import compile_kernel
from diffbot_sim.noise import NoiseSource, uniform
from diffbot_sim.robot_step import advance, sense_estimate, start
from diffbot_sim.sensors import purposes_of
from diffbot_sim.simulation import simulated_robot

Array = NDArray[np.float64]

DURATION = 60.0
"""[s] of a run"""
SKIPPED = 10.0
"""[s] time at the start of a run that is not evaluated"""
RATES = ((10, 1), (10, 5), (50, 10))
"""[Hz] rates of odometry and fixes"""
LOST_DISTANCE = 0.5
"""[m] position error above which a filter counts as lost"""
V_MIDDLE, V_HALF, OMEGA_HALF = 0.7, 0.3, 0.3
"""[m/s], [m/s], [rad/s] speeds of the drives: v is 0.7 +- 0.3 m/s, omega is +-0.3 rad/s"""
HISTORY_COLUMNS = ("position", "heading", "sigma_xy", "sigma_theta", "nees", "nis", "outcome")
"""Errors of the estimated position [m] and heading [rad]; their standard deviations according to the filter; normalised
estimation error squared (NEES) of the pose; normalised innovation squared (NIS) and outcome of the fix that arrives at
the step, or nan if no fix arrives."""
_FIXES = 0
"""row of the fixes in ``FilterState.last``"""
_CHUNK = 16
"""number of runs in one call of the kernel"""
_COLOURS = {EKF: "#999999", CALIBRATING: "#0072B2", FNN: "#E69F00", FNN_CALIBRATING: "#009E73"}


class Scenario(NamedTuple):
    """A fault of plant or sensors, or none, and the rates at which it is simulated."""

    name: str
    text: str
    label: str
    """label of the bars in the figure"""
    plant: PlantConfig = PlantConfig()
    sensors: SensorConfig = SensorConfig()
    landmarks: LandmarkMap = LandmarkMap()
    rates: tuple[tuple[int, int], ...] = RATES


_RADIUS = PlantConfig(right_radius_error=0.02)
_OUTLIERS = SensorConfig(fix_outlier=0.05)
_SLIP = PlantConfig(slip_right=0.6, slip_start=20.0, slip_duration=3.0)
_KIDNAPPED = PlantConfig(kidnap_time=20.0, kidnap_x=3.6, kidnap_yaw=1.0)
SCENARIOS = (
    Scenario("nominal", "noise as the filter assumes it", "right\nmodel"),
    Scenario("radius", "right wheel's radius 2 % too large", "radius\n+2 %", _RADIUS),
    Scenario("r_10", "R claimed 10 times as large", "R x 10", sensors=SensorConfig(fix_covariance_scale=10.0)),
    Scenario("r_01", "R claimed a tenth as large", "R x 0.1", sensors=SensorConfig(fix_covariance_scale=0.1)),
    Scenario("outliers", "5 % of the fixes are 3 m off", "out-\nliers", sensors=_OUTLIERS),
    Scenario("slip", "right wheel slips by 60 % from 20 s to 23 s", "slip", _SLIP),
    Scenario("kidnapped", "carried 3.6 m away and turned by 1 rad at 20 s", "kid-\nnapped", _KIDNAPPED),
    Scenario(
        "all",
        "outliers, slip, 2 % radius error, and carried away at 40 s",
        "all at\nonce",
        _SLIP._replace(right_radius_error=0.02, kidnap_time=40.0, kidnap_x=3.6, kidnap_yaw=1.0),
        _OUTLIERS,
    ),
    Scenario(
        "compass",
        "compass of +-5 deg at 10 Hz",
        "com-\npass",
        sensors=SensorConfig(heading_rate=10.0, heading_error_max=math.radians(5.0)),
        rates=RATES[:1],
    ),
    Scenario(
        "landmarks",
        "two landmarks 10 m apart at the start, measured from anywhere, at 5 Hz",
        "land-\nmarks",
        sensors=SensorConfig(landmark_rate=5.0, landmark_range=100.0),
        landmarks=LandmarkMap((0, 1), (-5.0, 5.0), (5.0, 5.0)),
        rates=RATES[:1],
    ),
)


class OpenLoopCase(NamedTuple):
    """Settings that all runs of a case share."""

    robot: SimulatedRobot
    steps: int
    skipped: int
    """number of steps at the start that are not evaluated"""
    kidnapped: int
    """first step after a kidnapping; -1 without a kidnapping"""


class Tracking(NamedTuple):
    """Statistics of one run, over the evaluated steps."""

    position: float
    """[m] root mean square of the position error"""
    heading: float
    """[rad] root mean square of the heading error"""
    largest: float
    """[m] largest position error"""
    end: float
    """[m] position error at the end"""
    back: float
    """[s] time from the kidnapping until the position error stays below LOST_DISTANCE; nan without a kidnapping"""
    nis: float
    """mean NIS of the fixes, including rejected fixes"""
    nees: float
    """mean NEES of the pose"""
    fixes: float
    """number of fixes"""
    rejected: float
    """number of rejected fixes"""
    relocated: float
    """number of fixes that relocated the filter"""


COLUMNS = Tracking._fields


def case_of(scenario: Scenario, odometry_rate: int, fix_rate: int, filter_name: str) -> OpenLoopCase:
    """Return the case of a scenario at rates [Hz] with one of FILTERS."""
    plant = scenario.plant._replace(sampling_time=1.0 / odometry_rate)
    sensors = scenario.sensors._replace(fix_rate=float(fix_rate))
    world = WorldConfig(plant, sensors, landmarks=scenario.landmarks)
    localization = LocalizationConfig(filter=FilterConfig(filter=filter_name))
    kidnapped = round(plant.kidnap_time * odometry_rate) if plant.kidnap_time > 0.0 else -1
    steps, skipped = round(DURATION * odometry_rate), round(SKIPPED * odometry_rate)
    return OpenLoopCase(simulated_robot(world, localization), steps, skipped, kidnapped)


def draw_drive(source: NoiseSource, seed: int, run: int) -> tuple[float, Twist]:
    """Draw the start heading [rad] and the constant twist of a run. The run starts at the origin."""
    v, omega, theta, _ = source.start(seed, run).tolist()
    return uniform(theta, math.pi), Twist(V_MIDDLE + uniform(v, V_HALF), uniform(omega, OMEGA_HALF))


def _drive(buffers: Any, theta: float, command: Twist, noise: Any, history: Any) -> None:
    """Simulate one drive with noise (purposes, steps + 1, 4) and fill its history (steps + 1, 7)."""
    robot = buffers.robot
    state, newest = start(buffers, Pose(0.0, 0.0, theta)), buffers.filter.last[_FIXES]
    for step in range(len(history)):
        state = sense_estimate(state, buffers, noise[:, step], robot.sensors, robot.plant.sampling_time)
        row, truth = history[step], state.plant.pose
        error, P = ekf.average(buffers.filter, robot.filter)
        error[0], error[1], error[2] = error[0] - truth.x, error[1] - truth.y, wrap_angle(error[2] - truth.theta)
        row[0], row[1] = math.hypot(error[0], error[1]), error[2]
        row[2], row[3] = state.feedback.uncertainty
        row[4], row[5], row[6] = ekf.normalised_square(error[:3], P), math.nan, math.nan
        if arriving_pose(buffers, step) >= 0:
            row[5], row[6] = newest[NIS], newest[OUTCOME]
        state = advance(state, buffers.commands, command, noise[:, step], robot.plant)


def _drive_all(buffers: Any, begins: Any, noise: Any, histories: Any) -> None:
    shared = reference_to(buffers)
    for run in range(len(histories)):
        theta, command = begins[run, 0], Twist(begins[run, 1], begins[run, 2])
        _drive(shared, theta, command, noise[run], histories[run])


_kernel = compile_kernel(_drive_all)


def _compile(robot: SimulatedRobot) -> None:
    """Compile the kernel before threads call it. One compilation suffices, as all robots have the same types."""
    if not _kernel.signatures:
        _kernel(new_buffers(robot), np.empty((0, 3)), np.empty((0, 1, 1, 4)), np.empty((0, 1, 7)))


def run_drives(case: OpenLoopCase, seed: int, runs: int, threads: int | None = None) -> Array:
    """Simulate the runs 0 to ``runs - 1`` in ``threads`` threads; None for one thread per core.

    Returns:
        (runs, 10), columns as COLUMNS. The result does not depend on the number of threads.
    """
    trackings: Array = np.empty((runs, len(COLUMNS)))

    def simulate_chunks(chunks: list[range]) -> None:
        for chunk in chunks:
            for run, history in zip(chunk, run_histories(case, seed, chunk), strict=True):
                trackings[run] = tracking_of(case, history)

    _compile(case.robot)
    in_threads(simulate_chunks, [range(at, min(at + _CHUNK, runs)) for at in range(0, runs, _CHUNK)], threads)
    return trackings


def run_histories(case: OpenLoopCase, seed: int, runs: range) -> Array:
    """Simulate some runs and return their histories (runs, steps + 1, 7), columns as HISTORY_COLUMNS."""
    robot, source, steps = case.robot, NoiseSource(), case.steps + 1
    purposes = purposes_of(robot.sensors, len(robot.landmarks), robot.plant.slip_noise)
    noise = np.array([source.run(seed, run, steps, purposes) for run in runs])
    begins = np.array([(theta, *twist) for theta, twist in (draw_drive(source, seed, run) for run in runs)])
    histories: Array = np.empty((len(runs), steps, len(HISTORY_COLUMNS)))
    _compile(robot)
    _kernel(new_buffers(robot), begins, noise, histories)
    return histories


def tracking_of(case: OpenLoopCase, history: Array) -> Tracking:
    """Return the statistics of one run from its history (steps + 1, 7). A position error of nan counts as lost."""
    position, heading, _, _, nees, nis, outcome = history[case.skipped + 1 :].T
    fixed, back = ~np.isnan(outcome), math.nan
    if case.kidnapped >= 0:
        away = np.flatnonzero(~(history[case.kidnapped :, 0] <= LOST_DISTANCE))
        back = (away[-1] + 1 if len(away) else 0) * case.robot.plant.sampling_time
    return Tracking(
        position=math.sqrt((position**2).mean()),
        heading=math.sqrt((heading**2).mean()),
        largest=position.max(),
        end=position[-1],
        back=back,
        nis=nis[fixed].mean(),
        nees=nees.mean(),
        fixes=fixed.sum(),
        rejected=(outcome == ekf.REJECTED).sum(),
        relocated=(outcome == ekf.RELOCATED).sum(),
    )


def figures_of(trackings: Array) -> dict[str, Any]:
    """Return the statistics of many runs (runs, 10), columns as COLUMNS."""
    column = dict(zip(COLUMNS, trackings.T, strict=True))
    runs, fixes, counted = len(trackings), column["fixes"], float(column["fixes"].sum())
    # Remove the rounding error of steps times sampling time: 28 steps of 0.1 s are 2.8 s.
    back = np.round(column["back"][~np.isnan(column["back"])], 9)
    return {
        "runs": runs,
        "position": _pooled(column["position"]),
        "heading": _pooled(column["heading"]),
        "largest": float(column["largest"].max()),
        "lost": int((~(column["end"] <= LOST_DISTANCE)).sum()),
        "back_median": float(np.median(back)) if len(back) else None,
        "back_max": float(back.max()) if len(back) else None,
        "nis": float((column["nis"] * fixes).sum() / counted),
        "nis_low": _chi_square_bound(0.025, counted),
        "nis_high": _chi_square_bound(0.975, counted),
        "nees": float(column["nees"].mean()),
        "nees_low": _chi_square_bound(0.025, runs),
        "nees_high": _chi_square_bound(0.975, runs),
        "rejected": float(column["rejected"].sum() / counted),
        "relocations": float(column["relocated"].mean()),
    }


def _pooled(errors: Array) -> dict[str, float]:
    """Return statistics of the RMSE of all runs: over all steps of all runs, the median, and the 95 % quantile."""
    rmse, median, p95 = math.sqrt(float((errors**2).mean())), float(np.median(errors)), float(np.quantile(errors, 0.95))
    return {"rmse": rmse, "median": median, "p95": p95}


def _chi_square_bound(share: float, samples: float) -> float:
    """Return the ``share`` quantile of the mean of ``samples`` chi-square variables with three degrees of freedom."""
    return float(chdtri(3.0 * samples, 1.0 - share) / samples)


def run_benchmark(runs: int, seed: int) -> dict[str, Any]:
    """Simulate all runs of all cases and return the content of results.json. On a terminal, show a progress bar."""
    cases = []
    pairs = [(scenario, *rates) for scenario in SCENARIOS for rates in scenario.rates]
    for scenario, odometry_rate, fix_rate in tqdm(pairs, desc="benchmark", unit="case", disable=None):
        case = {"name": f"{scenario.name}_{odometry_rate}_{fix_rate}", "scenario": scenario.name, "text": scenario.text}
        drives = {name: run_drives(case_of(scenario, odometry_rate, fix_rate, name), seed, runs) for name in FILTERS}
        filters = {name: figures_of(found) for name, found in drives.items()}
        cases.append({**case, "odometry_rate": odometry_rate, "fix_rate": fix_rate, "filters": filters})
    head = {"runs": runs, "seed": seed, "duration": DURATION, "skipped": SKIPPED}
    return {**head, "default_filter": FilterConfig().filter, "cases": cases}


def run_and_report(runs: int, seed: int, folder: Path) -> int:
    """Run the benchmark, write results.json and localization.png to ``folder``, and print the tables.

    Raises:
        DiffbotError: if the folder cannot be written or a value is not allowed.
    """
    with output_folder(folder):
        results = run_benchmark(runs, seed)
        write_json(folder / "results.json", results)
        print(*(described(one.name, plant=one.plant, sensors=one.sensors) for one in SCENARIOS), sep="\n")
        print("filter: variant as in the first column, otherwise the defaults; rates as in the rows")
        print(table(results))
        draw(results, folder / "localization.png")
    print(f"Results in {folder}")
    return 0


def table(results: dict[str, Any]) -> str:
    """Return a table of all cases for a terminal."""
    head = f"{'':<20}{'|pos| [m]: RMSE':>15}{'95 %':>7}{'max':>8}{'|theta| [rad]: RMSE':>21}{'95 %':>8}{'lost':>6}"
    head += f"{'back [s]: median':>18}{'max':>7}{'NIS':>9}{'NEES':>10}{'rejected':>10}{'relocations':>13}"
    rows = [head]
    for case in results["cases"]:
        rows += ["-" * len(head), f"{case['odometry_rate']}/{case['fix_rate']} Hz: {case['text']}"]
        rows += [_terminal_row(name, one) for name, one in case["filters"].items()]
    return "\n".join(rows)


def _terminal_row(name: str, one: dict[str, Any]) -> str:
    position, heading = one["position"], one["heading"]
    return (
        f"{name:<20}{number(position['rmse']):>15}{number(position['p95']):>7}{number(one['largest'], 2):>8}"
        f"{number(heading['rmse'], 4):>21}{number(heading['p95'], 4):>8}{one['lost']:>6}"
        f"{number(one['back_median'], 1):>18}{number(one['back_max'], 1):>7}{number(one['nis'], 2):>9}"
        f"{number(one['nees'], 2):>10}{100.0 * one['rejected']:>8.2f} %{number(one['relocations'], 2):>13}"
    )


def draw(results: dict[str, Any], path: Path) -> None:
    """Draw one run with all faults for each variant, with three standard deviations, and the RMSE of all cases.

    Raises:
        OSError: if the file cannot be written.
    """
    # Matplotlib takes long to load.
    from diffbot_tools.plotting import new_grid, save  # noqa: PLC0415

    figure, panels, bars = new_grid(len(FILTERS), len(RATES), (15.0, 7.8), left=0.06)
    (faulty,) = (one for one in SCENARIOS if one.name == "all")
    for axes, name in zip(panels, FILTERS, strict=True):
        case = case_of(faulty, *RATES[1], name)
        history = run_histories(case, results["seed"], range(1))[0]
        time = case.robot.plant.sampling_time * np.arange(len(history))
        axes.fill_between(
            time, 1e-3, 3.0 * history[:, 2], color=_COLOURS[name], alpha=0.3, label="3 sigma of the filter"
        )
        axes.plot(time, history[:, 0], color="black", linewidth=0.8, label="error")
        axes.set_yscale("log")
        axes.set_ylim(4e-3, 6.0)
        axes.set_xlim(0.0, time[-1])
        axes.set_title(name, fontsize="medium")
        axes.set_xlabel("time [s]")
        axes.tick_params(labelsize="small", labelleft=axes is panels[0])
        axes.legend(loc="upper left", fontsize="x-small")
    panels[0].set_ylabel("position error [m]\nall faults at once, 10/5 Hz")
    for axes, rates in zip(bars, RATES, strict=True):
        _draw_bars(axes, results, rates)
        axes.tick_params(labelleft=axes is bars[0])
    bars[0].set_ylabel("RMSE of position [m]\nall runs")
    handles, labels = bars[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="lower center", ncols=len(FILTERS), fontsize="small")
    save(figure, path)


def _draw_bars(axes: Any, results: dict[str, Any], rates: tuple[int, int]) -> None:
    labels = {one.name: one.label for one in SCENARIOS}
    cases = [one for one in results["cases"] if (one["odometry_rate"], one["fix_rate"]) == rates]
    places, width = np.arange(len(cases)), 0.8 / len(FILTERS)
    for index, name in enumerate(FILTERS):
        values = [one["filters"][name]["position"]["rmse"] for one in cases]
        at = places + (index - 0.5 * (len(FILTERS) - 1)) * width
        axes.bar(at, values, width, color=_COLOURS[name], label=name)
    axes.set_yscale("log")
    axes.set_ylim(0.01, 2.0)
    axes.set_xticks(places, [labels[one["scenario"]] for one in cases], fontsize="x-small")
    text = f"odometry {rates[0]} Hz, fixes {rates[1]} Hz"
    axes.text(0.02, 0.95, text, transform=axes.transAxes, verticalalignment="top")
