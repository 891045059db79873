"""Write the generated parts of docs/: ``python docs/generate.py [--check]``.

Sources: the tables in docs/reference/parameters/ and docs/reference/bags/check.md, and
diffbot_core/ros/parameter_names.py, the configuration types;
the table in docs/control.md, 100 runs of the closed loop;
docs/reproduction.md, docs/reproduction.json; docs/benchmark.md, docs/benchmark.json and docs/benchmark_bound.json;
the tables in docs/localization-results.md, docs/localization.json and docs/localization_colour.json;
those in docs/real-robots.md, docs/real.json and docs/calibration.json;
docs/faults.md, docs/faults.json (`make faults`, `make soak`); docs/rooms.svg, the imports.
``--experiments`` and ``--benchmark`` repeat the runs behind the JSON files and draw their figures; those behind
docs/benchmark_bound.json need casadi (extra ``bound``) and are repeated by ``--benchmark bound`` alone.
``--animation`` draws docs/run.gif, ``--policy`` runs the nodes and writes config/sros2_policy.xml.
The outputs on the tutorials are written by docs/tutorial_run.py, which runs them.
``--check`` writes nothing and fails if a page or rooms.svg is out of date.
"""

from __future__ import annotations

import argparse
import json
import math
import shutil
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import parameter_tables
from faults_page import page as faults_page
from geometry_picture import geometry_picture
from reproduction import page as reproduction_page
from rooms import picture as rooms_picture

from diffbot_bag.tools.contract import BagRules, TopicRules
from diffbot_control.law.presets import PAPER, PRESETS
from diffbot_core.files import write_json
from diffbot_core.geometry import Pose
from diffbot_core.schema import Spec, parameters_of
from diffbot_lab.benchmark import bound as bound_benchmark
from diffbot_lab.benchmark import filter as filter_benchmark
from diffbot_lab.benchmark import filter_colour, filter_colour_report, filter_report, law_report
from diffbot_lab.benchmark import law as law_benchmark
from diffbot_lab.benchmark.law_animation import AnimationOptions, drives
from diffbot_lab.benchmark.law_movie import write_movie
from diffbot_lab.benchmark.targets import markdown_table
from diffbot_lab.benchmark_commands import BENCHMARKS
from diffbot_lab.calibration import benchmark as calibration_benchmark
from diffbot_lab.cli import RUNS_OF_SCAN, SEED_OF_SCAN
from diffbot_lab.dataset import benchmark as real_benchmark
from diffbot_lab.dataset.calibrated import calibrated_table
from diffbot_lab.paper.experiment import run_experiment, summarise
from diffbot_lab.paper.figures import figure_paths
from diffbot_lab.paper.scan import run_scan
from diffbot_lab.paper.scenarios import SETTINGS
from diffbot_lab.security import policy
from diffbot_sim.feedback import EKF, RAW, TRUTH
from diffbot_sim.model.plant import PlantConfig
from diffbot_sim.model.sensors import SensorConfig
from diffbot_sim.model.simulator import WorldConfig
from diffbot_sim.reference_loop import simulate

DOCS = Path(__file__).parent
CHECK = DOCS / "reference/bags/check.md"
LOCALIZATION, COLOUR = "localization", "localization_colour"
"""Names of the results of the filter's benchmarks."""
REAL, CALIBRATION = "real", "calibration"
"""Names of the results on real drives, which no download repeats here, and of the calibration of simulated ones."""
RUNS = 100
SWITCHING_RUNS, OWN_RUNS, SWITCHING_SEED = 200, 1000, 7
"""Runs of each start in the comparison of the laws, of this one's, and a seed that is not that of their tuning."""
CALIBRATION_SEED = 3000
"""First seed of the calibrations: none of those that it was developed with."""
STEPS = 300
PAPER_PLANT = next(one.plant for one in SETTINGS if one.name == "raw")
QUIET = WorldConfig(
    plant=PlantConfig(drive_noise=0.0, encoder_noise=0.0),
    sensors=SensorConfig(eps_x_max=0.0, eps_y_max=0.0, eps_theta_max=0.0),
)


def check_page() -> str:
    """Return docs/reference/bags/check.md with the rules of contracts."""
    rows = [
        (part, f"`{one.name}`", one.spec.unit, one.spec.text + _choices(one.spec))
        for part, rules in (("bag", BagRules), ("topic", TopicRules))
        for one in parameters_of(rules)
    ]
    table = "\n".join(markdown_table(("of", "rule", "unit", "of what"), rows))
    return between_markers(CHECK.read_text(), "rules", table)


def _choices(spec: Spec) -> str:
    return f": {' or '.join(spec.choices)}" if spec.choices else ""


def localization_results_page() -> str:
    """Return docs/localization-results.md with the tables of both benchmarks of the filter."""
    text = (DOCS / "localization-results.md").read_text()
    results, coloured = (json.loads((DOCS / f"{name}.json").read_text()) for name in (LOCALIZATION, COLOUR))
    text = between_markers(text, "colour", filter_colour_report.page_part(coloured))
    return between_markers(text, "benchmark", filter_report.page_part(results))


def real_robots_page() -> str:
    """Return docs/real-robots.md with the tables of real drives, and of calibrations on simulated ones."""
    text = (DOCS / "real-robots.md").read_text()
    real, simulated = (json.loads((DOCS / f"{name}.json").read_text()) for name in (REAL, CALIBRATION))
    text = between_markers(text, "shipped", "\n\n".join(real_benchmark.table(one) for one in real["sets"]))
    text = between_markers(text, "calibrated", "\n\n".join(calibrated_table(one["calibrated"]) for one in real["sets"]))
    return between_markers(text, "simulated", calibration_benchmark.table(simulated))


def scenario_a_table() -> str:
    """Return the end states of the paper's simulation A under law (17) with the fixed region, 100 runs of 30 s."""
    head = ["the controller receives", "position error [m]: median", "p95", "max"]
    head += ["heading error [rad]: median", "p95", "max"]
    rows = []
    cases = (
        ("the EKF's estimate: fixes with the paper's noise, +-5 % per wheel", WorldConfig(), EKF),
        ("the raw fixes; input noise added (the paper's simulation)", WorldConfig(plant=PAPER_PLANT), RAW),
        ("the truth, no noise", QUIET, TRUTH),
    )
    for text, world, feedback in cases:
        ends = np.array([_end_state(world._replace(run=run), feedback) for run in range(RUNS)])
        numbers = [f"{n:.3f}" for column in ends.T for n in (*np.quantile(column, (0.5, 0.95)), column.max())]
        rows.append([text, *numbers])
    return "\n".join(markdown_table(head, rows))


def _end_state(world: WorldConfig, feedback: str) -> tuple[float, float]:
    x, y, theta = simulate(world, PRESETS[PAPER], Pose(0.0, 0.0, 0.0), STEPS, feedback).truth[-1].tolist()
    return math.hypot(x, y), abs(theta)


def write_experiments() -> None:
    """Run A, B and the scan; write their results and two of their figures to docs/."""
    results = {"scan": run_scan(RUNS_OF_SCAN, SEED_OF_SCAN)}
    for name, law_label, figure in (
        ("a", "law 17", "figure_07_path.png"),
        ("b", "heading 0 deg", "figure_10_path.png"),
    ):
        groups = run_experiment(name, RUNS, 1)
        results[name] = summarise(name, RUNS, 1, groups)
        shown = [group for group in groups if group.label == law_label and group.setting.name == "raw"]
        with tempfile.TemporaryDirectory() as folder, ThreadPoolExecutor(1) as pool:
            paths = [path for drawn in figure_paths(shown, Path(folder), pool) for path in drawn.result()]
            shutil.copy(next(path for path in paths if path.name == figure), DOCS / figure)
    write_json(DOCS / "reproduction.json", results)


def write_switching() -> None:
    """Run the benchmark of the law; write its results and its figure to docs/."""
    options = law_benchmark.ArenaOptions(SWITCHING_RUNS, SWITCHING_SEED, own_runs=OWN_RUNS)
    results, outcomes = law_benchmark.run_benchmark(options)
    write_json(DOCS / "benchmark.json", results)
    law_benchmark.draw(outcomes, options, DOCS / "benchmark.png")


def write_animation() -> None:
    """Draw docs/run.gif, as ``diffbot benchmark animate`` does."""
    shown, sampling_time = drives(AnimationOptions(BENCHMARKS["animate"][0], 1))
    write_movie(shown, sampling_time, DOCS / "run.gif")


def write_policy() -> None:
    """Run the nodes and write config/sros2_policy.xml from what they publish, subscribe to and serve."""
    # Only here: the rest of this program needs no ROS.
    from diffbot_lab.security.ros.reference_graph import reference_rights  # noqa: PLC0415

    policy.write_policy(DOCS.parent / "config/sros2_policy.xml", reference_rights(), policy.COMMENT)


def write_localization() -> None:
    """Run the benchmark of the filter; write its results and its figure to docs/."""
    results = filter_benchmark.run_benchmark(BENCHMARKS["localization"][0], 1)
    write_json(DOCS / f"{LOCALIZATION}.json", results)
    filter_benchmark.draw(results, DOCS / "localization.png")


def write_colour() -> None:
    """Run the benchmark of coloured fixes; write its results to docs/."""
    write_json(DOCS / f"{COLOUR}.json", filter_colour.run_benchmark(BENCHMARKS["colour"][0], 1))


def write_real(folders: list[Path]) -> None:
    """Filter and calibrate the drives of data sets; write the results to docs/."""
    sets = []
    for folder in folders:
        with tempfile.TemporaryDirectory() as out:
            real_benchmark.run_and_report(folder, Path(out) / REAL, figures=False, calibrated=True)
            sets.append(json.loads((Path(out) / REAL / "results.json").read_text()))
    write_json(DOCS / f"{REAL}.json", {"sets": sets})


def write_calibration() -> None:
    """Run the benchmark of the calibration; write its results to docs/."""
    with tempfile.TemporaryDirectory() as out:
        calibration_benchmark.run_and_report(BENCHMARKS[CALIBRATION][0], CALIBRATION_SEED, Path(out) / CALIBRATION)
        shutil.copy(Path(out) / CALIBRATION / "results.json", DOCS / f"{CALIBRATION}.json")


def write_bound() -> None:
    """Compute the bounds of the arena; write them to docs/. Needs casadi."""
    options = bound_benchmark.BoundOptions(BENCHMARKS["bound"][0], SWITCHING_SEED)
    bound_benchmark.run_bound(options, lambda found: write_json(DOCS / "benchmark_bound.json", found))


def benchmark_page() -> str:
    """Return docs/benchmark.md."""
    results, bounds = (json.loads((DOCS / name).read_text()) for name in ("benchmark.json", "benchmark_bound.json"))
    return law_report.page(results, bounds)


def between_markers(page: str, name: str, text: str) -> str:
    """Replace the text between the comments ``<!-- name -->`` and ``<!-- /name -->``."""
    start, end = f"<!-- {name} -->\n", f"\n<!-- /{name} -->"
    head, rest = page.split(start)
    return head + start + text + end + rest.split(end)[1]


def main() -> int:
    """Write or check the pages; return 1 if a check finds one out of date."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--check", action="store_true", help="write nothing, fail on a difference")
    parser.add_argument("--experiments", action="store_true", help="repeat the paper's experiments")
    parser.add_argument(
        "--benchmark",
        nargs="?",
        choices=("both", "switching", "localization", "colour", "calibration", "bound"),
        const="both",
        help="repeat those of the law and of the filter, or one",
    )
    parser.add_argument(
        "--real", type=Path, nargs="+", metavar="FOLDER", help="repeat those on the drives of data sets"
    )
    parser.add_argument("--animation", action="store_true", help="draw run.gif again")
    parser.add_argument("--policy", action="store_true", help="write config/sros2_policy.xml from running nodes")
    options = parser.parse_args()
    if options.experiments:
        write_experiments()
    if options.benchmark in ("both", "switching"):
        write_switching()
    if options.benchmark in ("both", "localization"):
        write_localization()
    if options.benchmark in ("both", "colour"):
        write_colour()
    if options.benchmark in ("both", CALIBRATION):
        write_calibration()
    if options.real:
        write_real(options.real)
    if options.animation:
        write_animation()
    if options.policy:
        write_policy()
    if options.benchmark == "bound":
        write_bound()
    control = DOCS / "control.md"
    experiments = json.loads((DOCS / "reproduction.json").read_text())
    pages = {
        **parameter_tables.pages(),
        DOCS.parent / "diffbot_core/ros/parameter_names.py": parameter_tables.names_module(),
        DOCS / "reproduction.md": reproduction_page(experiments["a"], experiments["b"], experiments["scan"]),
        DOCS / "benchmark.md": benchmark_page(),
        CHECK: check_page(),
        DOCS / "localization-results.md": localization_results_page(),
        DOCS / "real-robots.md": real_robots_page(),
        DOCS / "faults.md": faults_page(json.loads((DOCS / "faults.json").read_text())),
        DOCS / "rooms.svg": rooms_picture(),
        DOCS / "explanation/geometry.svg": geometry_picture(),
        control: between_markers(control.read_text(), "scenario A", scenario_a_table()),
    }
    stale = [path for path, text in pages.items() if not path.is_file() or path.read_text() != text]
    for path in stale:
        if options.check:
            print(f"{path.name} is out of date: run python docs/generate.py")
        else:
            path.write_text(pages[path])
            print(f"{path.name} written")
    return 1 if options.check and stale else 0


if __name__ == "__main__":
    sys.exit(main())
