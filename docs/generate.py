"""Write the generated parts of docs/: ``python docs/generate.py [--check]``.

docs/parameters.md comes from the configuration types; the table in docs/control.md from 100 runs of the closed loop;
docs/reproduction.md from docs/reproduction.json, which ``--experiments`` makes anew together with its figures;
docs/benchmark.md from docs/benchmark.json and the tables in docs/localization.md from docs/localization.json, which
``--benchmark`` makes anew together with their figures.
``--check`` writes nothing and fails if something would change.
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
from typing import Any

import numpy as np
from reproduction import page

from diffbot_bag.parameters import RecorderConfig, ReplayConfig
from diffbot_control.filter.localization import LocalizationConfig
from diffbot_control.law.presets import PAPER, PRESETS, TUNED
from diffbot_control.ros.controller_parameters import CONTROLLER_PRESETS, ControllerNodeConfig
from diffbot_control.ros.ekf_parameters import EkfNodeConfig
from diffbot_core.files import write_json
from diffbot_core.geometry import Pose
from diffbot_core.schema import parameters_of, to_dict
from diffbot_lab.benchmark import (
    filter as localization_benchmark,
)
from diffbot_lab.benchmark import (
    filter_report as localization_report,
)
from diffbot_lab.benchmark import (
    law as benchmark,
)
from diffbot_lab.benchmark import (
    law_report as benchmark_report,
)
from diffbot_lab.cli import BENCHMARKS
from diffbot_lab.paper.experiment import run_experiment, summarise
from diffbot_lab.paper.figures import figure_paths
from diffbot_sim.model.plant import PlantConfig
from diffbot_sim.model.sensors import SensorConfig
from diffbot_sim.model.simulator import WorldConfig
from diffbot_sim.reference_loop import EKF, RAW, TRUTH, simulate
from diffbot_sim.ros.parameters import PlantNodeConfig

DOCS = Path(__file__).parent
NODES = {
    "controller": ControllerNodeConfig,
    "ekf": EkfNodeConfig,
    "plant": PlantNodeConfig,
    "recorder": RecorderConfig,
    "replay": ReplayConfig,
}
RUNS = 100
STEPS = 300
PAPER_NOISE = PlantConfig(exact_arc=False, drive_noise=0.0, encoder_noise=0.0, eps_v_max=0.065, eps_omega_max=0.2167)
QUIET = WorldConfig(
    plant=PlantConfig(drive_noise=0.0, encoder_noise=0.0),
    sensors=SensorConfig(eps_x_max=0.0, eps_y_max=0.0, eps_theta_max=0.0),
)


def parameters_page() -> str:
    """List the parameters of all nodes."""
    lines = [
        "# Parameters",
        "",
        "Made by `make docs` from the configuration types; a test holds it to them. A node refuses to",
        "start with a value outside its bounds, and refuses to be set to one, naming parameter, value and bound.",
        "*Fixed*: read at the start only. A text or list default of nothing is shown as `-`. The controller's defaults",
        "come from its parameter `preset`.",
    ]
    for node, config_type in NODES.items():
        tuned, paper = (to_dict(CONTROLLER_PRESETS[name]) if node == "controller" else {} for name in (TUNED, PAPER))
        lines += ["", f"## {node}", "", *_parameter_table(config_type, tuned, paper)]
    return "\n".join(lines) + "\n"


def _parameter_table(config_type: type[Any], tuned: dict[str, Any], paper: dict[str, Any]) -> list[str]:
    lines = ["| parameter | default | unit | allowed | fixed | meaning |", "|---|---|---|---|---|---|"]
    for parameter in parameters_of(config_type):
        default = _shown(tuned.get(parameter.name, parameter.default))
        if tuned.get(parameter.name) != paper.get(parameter.name):
            default += f" (paper: {_shown(paper[parameter.name])})"
        spec = parameter.spec
        allowed = spec.bound() if parameter.type in (float, int) or spec.choices else ""
        fixed = "yes" if spec.read_only else ""
        cells = (f"`{parameter.name}`", default, spec.unit, allowed, fixed, spec.text)
        lines.append("| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |")
    return lines


def localization_page() -> str:
    """Fill in the parameters and the benchmark's tables in docs/localization.md."""
    text = (DOCS / "localization.md").read_text()
    text = between_markers(text, "parameters", "\n".join(_parameter_table(LocalizationConfig, {}, {})))
    results = json.loads((DOCS / "localization.json").read_text())
    return between_markers(text, "benchmark", localization_report.page_part(results))


def _shown(value: Any) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if not value and isinstance(value, (str, tuple)):
        return "-"
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def scenario_a_table() -> str:
    """End states of the paper's scenario A under the law (17) with the fixed region, 100 runs of 30 s."""
    rows = [
        "| what the controller sees | position error [m]: median | p95 | max "
        "| heading error [rad]: median | p95 | max |",
        "|---|---|---|---|---|---|---|",
    ]
    cases = (
        ("EKF: fixes with the paper's noise, +-5 % per wheel", WorldConfig(), EKF),
        ("the raw fixes, input noise added (the paper's simulation)", WorldConfig(plant=PAPER_NOISE), RAW),
        ("the truth, no noise", QUIET, TRUTH),
    )
    for text, world, feedback in cases:
        ends = np.array([_end_state(world._replace(run=run), feedback) for run in range(RUNS)])
        numbers = [f"{n:.3f}" for column in ends.T for n in (*np.quantile(column, (0.5, 0.95)), column.max())]
        rows.append(f"| {text} | " + " | ".join(numbers) + " |")
    return "\n".join(rows)


def _end_state(world: WorldConfig, feedback: str) -> tuple[float, float]:
    x, y, theta = simulate(world, PRESETS[PAPER], Pose(0.0, 0.0, 0.0), STEPS, feedback).truth[-1].tolist()
    return math.hypot(x, y), abs(theta)


def write_experiments() -> None:
    """Run A and B and keep their results and two of their figures."""
    results = {}
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
    """Run the benchmark of the law and keep its results and its figure."""
    results, outcomes = benchmark.run_benchmark(RUNS, 1)
    write_json(DOCS / "benchmark.json", results)
    benchmark.draw(outcomes, 1, DOCS / "benchmark.png")


def write_localization() -> None:
    """Run the benchmark of the filter and keep its results and its figure."""
    results = localization_benchmark.run_benchmark(BENCHMARKS["localization"][1], 1)
    write_json(DOCS / "localization.json", results)
    localization_benchmark.draw(results, DOCS / "localization.png")


def between_markers(page: str, name: str, text: str) -> str:
    """Replace what stands between the comments ``<!-- name -->`` and ``<!-- /name -->``."""
    start, end = f"<!-- {name} -->\n", f"\n<!-- /{name} -->"
    head, rest = page.split(start)
    return head + start + text + end + rest.split(end)[1]


def main() -> int:
    """Write or check; 1 if a check finds a difference."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--check", action="store_true", help="write nothing, fail on a difference")
    parser.add_argument("--experiments", action="store_true", help="run the paper's experiments anew")
    parser.add_argument(
        "--benchmark", nargs="?", choices=("both", *BENCHMARKS), const="both", help="run both benchmarks, or one, anew"
    )
    options = parser.parse_args()
    if options.experiments:
        write_experiments()
    if options.benchmark in ("both", "switching"):
        write_switching()
    if options.benchmark in ("both", "localization"):
        write_localization()
    control = DOCS / "control.md"
    experiments = json.loads((DOCS / "reproduction.json").read_text())
    pages = {
        DOCS / "parameters.md": parameters_page(),
        DOCS / "reproduction.md": page(experiments["a"], experiments["b"]),
        DOCS / "benchmark.md": benchmark_report.page(json.loads((DOCS / "benchmark.json").read_text())),
        DOCS / "localization.md": localization_page(),
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
