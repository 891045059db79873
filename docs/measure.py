"""Repeat the measurements behind docs/results: ``generate.py --benchmark`` and its other options call this.

Results go to the JSON files in docs/results/data, pictures to docs/results/figures.
"""

from __future__ import annotations

import json
import shutil
import tempfile
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

from docking_movie import write_docking_movie

from diffbot_control.law.configuration import ControllerConfig
from diffbot_core.files import write_json
from diffbot_core.schema import build
from diffbot_lab.arena import command as law_benchmark
from diffbot_lab.arena import effects as law_effects
from diffbot_lab.arena.animation import AnimationOptions, drives, write_movie
from diffbot_lab.arena.bounds import command as bound_benchmark
from diffbot_lab.arena.docking import report as docking_report
from diffbot_lab.arena.docking.study import run_study
from diffbot_lab.benchmark_command import BENCHMARKS, PEER
from diffbot_lab.commands import RUNS_OF_SCAN, SEED_OF_SCAN
from diffbot_lab.filter_benchmark import calibration as calibration_benchmark
from diffbot_lab.filter_benchmark import colour as filter_colour
from diffbot_lab.filter_benchmark import command as filter_benchmark
from diffbot_lab.filter_benchmark import peer as peer_benchmark
from diffbot_lab.filter_benchmark import real_command as real_benchmark
from diffbot_lab.filter_benchmark import states as filter_states
from diffbot_lab.paper.experiment import run_experiment, summarise
from diffbot_lab.paper.figures import figure_paths
from diffbot_lab.paper.scan import run_scan
from diffbot_lab.security import policy
from diffbot_lab.stability.adversary.command import run_adversary
from diffbot_lab.stability.certificates import certify_and_save, run_verify
from diffbot_lab.stability.contract.command import RUNS, RUNS_OF_ROBOT, SEED, run_contract, runs_of_arena, runs_of_robot
from diffbot_lab.stability.plan import Contract, Plan
from diffbot_lab.stability.robot import certify_robot
from diffbot_tools.robot.robot import read_robot

DOCS = Path(__file__).parent
RESULTS = DOCS / "results"
DATA = RESULTS / "data"
FIGURES = RESULTS / "figures"
LOCALIZATION, COLOUR, STATES, EFFECTS = "localization", "localization_colour", "localization_states", "effects"
"""Names of the results of the filter's benchmarks, and of the changed parameters."""
REAL, CALIBRATION = "real", "calibration"
"""Names of the results on real drives, which no download repeats here, and of the calibration of simulated ones."""
DOCKING = "docking"
"""Name of the results of the docking study."""
DOCKING_SEED = 2014
"""Of its starts and noise: none of those that docking was developed with."""
CONTRACT = "contract"
"""Name of the results on the contract of certificates ..."""
ROBOTS = ("turtlebot4", "warehouse_agv")
"""... and robots that it is looked at with."""
STABILITY = "stability"
"""Name of the figures of the certificates, and of the picture of the first one."""
CERTIFIED_ROBOT, SINCE = "turtlebot4", 10.0
"""Robot that is certified by its parameter file, and time [s] from which on its contract is measured."""
LIMITS = {"linear.x.max_acceleration": 0.5, "angular.z.max_acceleration": 1.5}
"""Limits of the acceleration that the default robot is certified with, too."""
LIMITED = Contract(eps_v=0.02, eps_omega=0.1)
"""Contract of a base with these limits."""
ON_THE_WAY = Contract(0.13, 0.075, 0.053, position_slope=0.02, theta_slope=0.02, sigma_slope=0.01)
"""Contract that a filter keeps as of its first seconds: all of 600 runs each of the cases nominal and random_far with
seed 11 keep each bound from 3 s on."""
ATTACK_STEPS, ATTACK_RUNS, ATTACK_SEED = 1_000_000, 100_000, 1
"""Steps, runs and seed of the random errors against each certificate."""
PAPER_RUNS = 100
SWITCHING_RUNS, OWN_RUNS, SWITCHING_SEED = 200, 1000, 7
"""Runs of each start in the comparison of the laws, of this one's, and a seed that is not that of their tuning."""
CALIBRATION_SEED = 3000
"""First seed of the calibrations: none of those that it was developed with."""
PEER_SEED = 1
"""First seed of the comparison with robot_localization, which is tuned on others."""


def write_experiments() -> None:
    """Run A, B and the scan; write their results and two of their figures to docs/."""
    results = {"scan": run_scan(RUNS_OF_SCAN, SEED_OF_SCAN)}
    for name, law_label, figure in (
        ("a", "law 17", "figure_07_path.png"),
        ("b", "heading 0 deg", "figure_10_path.png"),
    ):
        groups = run_experiment(name, PAPER_RUNS, 1)
        results[name] = summarise(name, PAPER_RUNS, 1, groups)
        shown = [group for group in groups if group.label == law_label and group.setting.name == "raw"]
        with tempfile.TemporaryDirectory() as folder, ThreadPoolExecutor(1) as pool:
            paths = [path for drawn in figure_paths(shown, Path(folder), pool) for path in drawn.result()]
            shutil.copy(next(path for path in paths if path.name == figure), FIGURES / figure)
    write_json(DATA / "reproduction.json", results)


def write_switching() -> None:
    """Run the benchmark of the law; write its results and its figure to docs/results."""
    options = law_benchmark.ArenaOptions(SWITCHING_RUNS, SWITCHING_SEED, own_runs=OWN_RUNS)
    results, outcomes = law_benchmark.run_benchmark(options)
    write_json(DATA / "benchmark.json", results)
    law_benchmark.draw(outcomes, options, FIGURES / "benchmark.png")


def write_effects() -> None:
    """Run the law with each parameter changed; write the results to docs/results."""
    write_json(DATA / f"{EFFECTS}.json", law_effects.run_effects(BENCHMARKS[EFFECTS][0], SWITCHING_SEED))


def write_animation() -> None:
    """Draw docs/run.gif, as ``diffbot benchmark animate`` does, and docs/docking.gif."""
    shown, sampling_time = drives(AnimationOptions(BENCHMARKS["animate"][0], 1))
    write_movie(shown, sampling_time, DOCS / "run.gif")
    write_docking_movie(DOCS / "docking.gif")


def write_policy() -> None:
    """Run the nodes and write config/sros2_policy.xml from what they publish, subscribe to and serve."""
    # Only here: the rest of this program needs no ROS.
    from diffbot_lab.security.ros.reference_graph import reference_rights  # noqa: PLC0415

    policy.write_policy(DOCS.parent / "config/sros2_policy.xml", reference_rights(), policy.COMMENT)


def write_localization() -> None:
    """Run the benchmark of the filter; write its results and its figure to docs/results."""
    results = filter_benchmark.run_benchmark(BENCHMARKS["localization"][0], 1)
    write_json(DATA / f"{LOCALIZATION}.json", results)
    filter_benchmark.draw(results, FIGURES / "localization.png")


def write_colour() -> None:
    """Run the benchmark of coloured fixes; write its results to docs/results."""
    write_json(DATA / f"{COLOUR}.json", filter_colour.run_benchmark(BENCHMARKS["colour"][0], 1))


def write_states() -> None:
    """Run the benchmark of the filter's states; write its results to docs/results."""
    write_json(DATA / f"{STATES}.json", filter_states.run_benchmark(BENCHMARKS["states"][0], 1))


def write_real(folders: list[Path]) -> None:
    """Filter and calibrate the drives of data sets; write the results to docs/."""
    sets = []
    for folder in folders:
        with tempfile.TemporaryDirectory() as out:
            real_benchmark.run_and_report(folder, Path(out) / REAL, figures=False, calibrated=True)
            sets.append(json.loads((Path(out) / REAL / "results.json").read_text()))
    write_json(DATA / f"{REAL}.json", {"sets": sets})


def write_peer(runner: Path) -> None:
    """Compare the filter with robot_localization; write the results to docs/results."""
    runs, _ = BENCHMARKS[PEER]
    write_json(DATA / f"{PEER}.json", peer_benchmark.run_benchmark(runner.resolve(), runs, PEER_SEED))


def write_calibration() -> None:
    """Run the benchmark of the calibration; write its results to docs/results."""
    with tempfile.TemporaryDirectory() as out:
        calibration_benchmark.run_and_report(BENCHMARKS[CALIBRATION][0], CALIBRATION_SEED, Path(out) / CALIBRATION)
        shutil.copy(Path(out) / CALIBRATION / "results.json", DATA / f"{CALIBRATION}.json")


def write_bound() -> None:
    """Compute the bounds of the arena; write them to docs/results. Needs casadi."""
    options = bound_benchmark.BoundOptions(BENCHMARKS["bound"][0], SWITCHING_SEED)
    bound_benchmark.run_bound(options, lambda found: write_json(DATA / "benchmark_bound.json", found))


def write_docking() -> None:
    """Run the docking study; write its results and its figure to docs/results."""
    results, shown = run_study(BENCHMARKS[DOCKING][0], DOCKING_SEED)
    write_json(DATA / f"{DOCKING}.json", results | docking_report.conclusions(results))
    docking_report.draw(shown, FIGURES / f"{DOCKING}.png")


def write_contract() -> None:
    """Count how often estimate and base keep a contract in the arena's cases and with robots of presets.

    The bounds of the base are what limits of the acceleration are certified with; where the base obeys at once they do
    not matter.
    """
    robots = [runs_of_robot(read_robot(name), RUNS_OF_ROBOT, SEED) for name in ROBOTS]
    runs, base = (
        [*runs_of_arena(RUNS, SEED), *robots],
        {name: getattr(LIMITED, name) for name in ("eps_v", "eps_omega")},
    )
    contracts = (LIMITED, ON_THE_WAY._replace(**base))
    write_json(DATA / f"{CONTRACT}.json", {"contracts": [run_contract(runs, one, SEED) for one in contracts]})


def write_stability() -> None:
    """Certify three robots, one with two contracts; check and attack each certificate."""
    results: list[dict[str, Any]] = []
    with tempfile.TemporaryDirectory() as folder:
        path, out = Path(folder) / "certificate.json", Path(folder) / "attack"

        def attacked(robot: str, **more: Any) -> None:
            run_verify(path)
            run_adversary(path, ATTACK_STEPS, ATTACK_RUNS, ATTACK_SEED, out)
            results.append({"robot": robot, **more, **json.loads((out / "adversary.json").read_text())})
            if len(results) == 1:
                shutil.copy(out / "adversary.png", FIGURES / f"{STABILITY}.png")

        certify_and_save(ControllerConfig(), Plan(), path)
        attacked("default")
        certify_and_save(ControllerConfig(), Plan(ON_THE_WAY), path)
        attacked("default, with a contract for the way")
        certify_and_save(build(ControllerConfig, LIMITS), Plan(LIMITED), path)
        attacked("default with 0.5 m/s^2 and 1.5 rad/s^2")
        _, share = certify_robot(CERTIFIED_ROBOT, {}, SINCE, {}, path, None)
        attacked(CERTIFIED_ROBOT, since=SINCE, kept=share._asdict())
    write_json(DATA / f"{STABILITY}.json", {"certificates": results})


ALL = "all"
WRITERS: dict[str, tuple[Callable[[], None], ...]] = {
    "switching": (write_switching,),
    "effects": (write_effects,),
    "localization": (write_localization,),
    "colour": (write_colour,),
    "states": (write_states,),
    CALIBRATION: (write_calibration,),
    CONTRACT: (write_contract,),
    DOCKING: (write_docking,),
    STABILITY: (write_stability,),
    ALL: (
        *(write_switching, write_effects, write_localization, write_colour, write_states),
        *(write_calibration, write_contract, write_docking, write_stability),
    ),
    "bound": (write_bound,),
}
"""What ``--benchmark`` repeats; the bounds only by their name, since they need casadi."""
