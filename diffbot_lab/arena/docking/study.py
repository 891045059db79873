"""Docking and a peer's under equal conditions: ``diffbot benchmark docking``.

Run i has the same start and the same noise under both laws, which receive the same filter's estimate in the frame of
the dock. What counts is contact: the first time that the true pose crosses x = 0 of the dock's frame going in.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from diffbot_control.filter.options import CALIBRATING, FilterConfig
from diffbot_control.goals.protocol import Law
from diffbot_control.law.controller import ControllerConfig
from diffbot_control.law.docking import Docking
from diffbot_core.errors import InvalidValueError
from diffbot_core.schema import build, parameters_of
from diffbot_lab.arena.cases import LIMITS, cases_named, cases_of
from diffbot_lab.arena.statistics import spread
from diffbot_lab.campaign.statistics import wilson
from diffbot_lab.cases import Configuration, make_case
from diffbot_lab.laws.nav2_docking import Nav2Docking
from diffbot_sim.compiled.batch import Starts, run_histories
from diffbot_sim.compiled.closed_loop import Case
from diffbot_sim.model.plant import PlantConfig
from diffbot_sim.model.sensors import SensorConfig

Array = NDArray[np.float64]

DURATION = 60.0
"""[s] of a run"""
XY_TOLERANCE, YAW_TOLERANCE = 0.02, math.radians(2.0)
"""[m], [rad] across and in heading at contact: within these the robot is docked"""
FILTER = FilterConfig(filter=CALIBRATING, wheels_as_configured=0.0, wheel_radius_sigma=0.02)
"""Of a robot whose wheels are not as configured: as a dock's configuration has it."""
LAWS: dict[str, Law] = {"docking": Docking, "nav2_docking": Nav2Docking}
OWN, PEER = LAWS
MIDDLE = (-1.7, -1.3)
"""[m] starts whose times are counted by themselves: about 1.5 m before the dock"""
_LOW, _HIGH = (-3.0, -0.5, -math.pi / 4.0), (-0.5, 0.5, math.pi / 4.0)
_CHUNK = 500
"""runs whose histories are in memory at a time"""
CONTACT_COLUMNS = ("lateral", "heading", "time", "speed")
"""[m], [rad] errors, [s], [m/s] along the axis; nan without contact"""


class DockingCase(NamedTuple):
    """One case: what differs from 20 % lost detections and the realistic mix of actuators."""

    name: str
    text: str
    detector: tuple[tuple[str, float], ...] = ()
    """parameters of the detector"""
    is_mixed: bool = True
    """the actuators are the arena's realistic mix; otherwise ideal but for the speeds"""
    backward: bool = False
    sampling_time: float = 0.1
    """[s]"""


CASES = (
    DockingCase("docking", "realistic mix of actuators, 20 % of the detections lost"),
    DockingCase("docking_no_loss", "no detection lost", (("detection_dropout", 0.0),)),
    DockingCase("docking_outliers", "5 % of the detections 0.5 m off", (("detection_outlier", 0.05),)),
    DockingCase("docking_backward", "the back of the robot docks", backward=True),
    DockingCase("docking_no_mix", "ideal actuators", is_mixed=False),
    DockingCase("docking_50_hz", "control at 50 Hz instead of 10 Hz", sampling_time=0.02),
)


def docking_cases(names: tuple[str, ...]) -> tuple[DockingCase, ...]:
    """Return the cases of these names, see :func:`cases_of`."""
    return cases_of(CASES, names)


def case_of(case: DockingCase, law: Law) -> Case:
    """Return what all runs of a law in a case share; the data sheet is known to the law."""
    (mix,) = cases_named(("mix",))
    actuators = {name: value for name, value in mix.world.items() if not name.startswith("fix_")}
    plant = {"wheel_speed_max": LIMITS["wheel.max_velocity"], "sampling_time": case.sampling_time}
    plant |= actuators if case.is_mixed else {}
    sensors = {"fix_rate": 0.0, "detection_rate": 10.0, **dict(case.detector)}
    names = {one.name for one in parameters_of(law.Config)}
    sheet = {**LIMITS, **(mix.sheet if case.is_mixed else {}), "dock_backward": case.backward}
    config = build(law.Config, {name: value for name, value in sheet.items() if name in names})
    shared = Configuration(build(PlantConfig, plant), build(SensorConfig, sensors), ControllerConfig(), FILTER)
    return make_case(shared, DURATION, tolerance=(XY_TOLERANCE, YAW_TOLERANCE))._replace(controller=config)


def docking_starts(count: int, seed: int) -> Array:
    """Return starts (count, 3) [m, m, rad] before a dock at the origin: 0.5 to 3 m, +-0.5 m beside, +-45 degrees."""
    return np.random.default_rng((seed, 1)).uniform(_LOW, _HIGH, (count, 3))


def turned(poses: Array) -> Array:
    """Return poses (..., n >= 3) with the frame of the dock turned round: where the back is at, if the front was."""
    found: Array = poses.copy()
    found[..., :2] *= -1.0
    return found


def contacts(histories: Array, sampling_time: float) -> Array:
    """Return the contacts (runs, 4), see CONTACT_COLUMNS, of histories (runs, steps + 1, >= 3) with x, y, theta first.

    The robot docks driving along x. Between two steps all values are interpolated linearly.
    """
    x = histories[:, :, 0]
    crossing = (x[:, :-1] < 0.0) & (x[:, 1:] >= 0.0)
    runs = np.flatnonzero(crossing.any(axis=1))
    at = crossing[runs].argmax(axis=1)
    before, after = histories[runs, at, :3], histories[runs, at + 1, :3]
    way = after - before
    way[:, 2] = (way[:, 2] + math.pi) % (2.0 * math.pi) - math.pi
    share = -before[:, 0] / way[:, 0]
    found: Array = np.full((len(histories), len(CONTACT_COLUMNS)), np.nan)
    pose = before + share[:, np.newaxis] * way
    found[runs] = np.column_stack((pose[:, 1], pose[:, 2], (at + share) * sampling_time, way[:, 0] / sampling_time))
    return found


def run_docking(
    case: DockingCase, law: Law, starts: Array, seed: int, done: Callable[[int], Any] = id
) -> tuple[Array, Array]:
    """Return the contacts (runs, 4) of one run from each start, and the paths (<= 500, steps + 1, 3) of the first ones.

    Both are in the frame of the dock, turned round where the robot docks backwards.
    """
    shared, found, paths = case_of(case, law), [], np.empty((0, 0, 3))
    rows = Starts(turned(starts) if case.backward else starts)
    for first in range(0, len(starts), _CHUNK):
        count = min(_CHUNK, len(starts) - first)
        histories = run_histories(shared, rows, seed, first, count, law=law)[:, :, :3]
        histories = turned(histories) if case.backward else histories
        found.append(contacts(histories, shared.plant.sampling_time))
        paths = histories if first == 0 else paths
        done(count)
    return np.concatenate(found), paths


def is_docked(found: Array) -> NDArray[np.bool_]:
    """Return which contacts (runs, 4) are within the tolerances."""
    # Compared with nan, without contact, this is False.
    docked: NDArray[np.bool_] = (np.abs(found[:, 0]) <= XY_TOLERANCE) & (np.abs(found[:, 1]) <= YAW_TOLERANCE)
    return docked


def figures_of(found: Array, starts: Array) -> dict[str, Any]:
    """Return the figures of contacts (runs, 4) from starts (runs, 3)."""
    touched = ~np.isnan(found[:, 0])
    docked = int(is_docked(found).sum())
    middle = touched & (starts[:, 0] >= MIDDLE[0]) & (starts[:, 0] <= MIDDLE[1])
    return {
        "runs": len(found),
        "docked": docked,
        "docked_interval": list(wilson(docked, len(found))),
        "beside": int(touched.sum()) - docked,
        "no_contact": int((~touched).sum()),
        "lateral": spread(np.abs(found[touched, 0])),
        "heading": spread(np.abs(found[touched, 1])),
        "time": spread(found[touched, 2]),
        "middle_runs": int(middle.sum()),
        "middle_time": spread(found[middle, 2]),
        "speed": spread(found[touched, 3]),
    }


def run_study(
    runs: int, seed: int, names: tuple[str, ...] = (), keep: Callable[[dict[str, Any]], Any] = id
) -> tuple[dict[str, Any], dict[str, tuple[Array, Array]]]:
    """Execute all runs, with a progress bar on a terminal.

    Args:
        runs: of each law in each case.
        seed: of starts and noise.
        names: of cases; none: all.
        keep: called with the results after each case, so that an interrupt loses one case at most.

    Returns:
        The content of results.json; contacts and paths of each law in the first case.

    Raises:
        InvalidValueError: for fewer than one run or an unknown case.
    """
    if runs < 1:
        raise InvalidValueError("runs", runs, ">= 1")
    cases, starts = docking_cases(names), docking_starts(runs, seed)
    results: dict[str, Any] = {"runs": runs, "seed": seed, "duration": DURATION, "cases": []}
    shown: dict[str, tuple[Array, Array]] = {}
    with tqdm(total=runs * len(cases) * len(LAWS), desc="docking", unit="run", disable=None) as bar:
        for case in cases:
            done = {name: run_docking(case, law, starts, seed, bar.update) for name, law in LAWS.items()}
            shown = shown or done
            docked = {name: is_docked(found) for name, (found, _) in done.items()}
            row: dict[str, Any] = {"name": case.name, "text": case.text}
            row["laws"] = {name: figures_of(found, starts) for name, (found, _) in done.items()}
            row["only_own_docked"] = int((docked[OWN] & ~docked[PEER]).sum())
            row["only_peer_docked"] = int((docked[PEER] & ~docked[OWN]).sum())
            results["cases"].append(row)
            keep(results)
    return results, shown
