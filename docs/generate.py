"""Write the generated parts of docs/: ``python docs/generate.py [--check]``.

Sources: the tables in docs/reference/parameters/ and docs/reference/bags/check.md: the configuration types; the table
in docs/explanation/law/paper.md: 100 runs of the closed loop; docs/rooms.svg: the imports;
docs/reference/nodes/states.svg: the states of a goal; docs/badges: the package's metadata. In
docs/results, from the JSON files in its folder data: benchmark.md, reproduction.md, faults.md (`make faults`,
`make soak`), docking.md, performance.md (`make bench`), trust.md (`make trust`), and the tables in filter.md,
real-robots.md, robot-localization.md and docs/explanation/stability.md.
``--experiments`` and ``--benchmark`` repeat the runs behind the JSON files and draw their figures; those behind
benchmark_bound.json need casadi (extra ``bound``) and are repeated by ``--benchmark bound`` alone.
``--animation`` draws docs/run.gif and docking.gif, ``--policy`` runs the nodes and writes config/sros2_policy.xml.
The outputs on the tutorials are written by docs/tutorial_run.py, which runs them.
``--check`` writes nothing and fails if a page or rooms.svg is out of date.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
from pathlib import Path
from typing import Any

import filter_page
import measure
import numpy as np
import parameter_tables
from badges import badges
from benchmark_page import page as benchmark_page
from docking_page import page as docking_page
from faults_page import page as faults_page
from geometry_picture import geometry_picture
from measure import (
    CALIBRATION,
    COLOUR,
    CONTRACT,
    DATA,
    DOCKING,
    EFFECTS,
    LOCALIZATION,
    PEER,
    REAL,
    RESULTS,
    STABILITY,
    STATES,
)
from performance_page import page as performance_page
from reproduction import page as reproduction_page
from rooms import picture as rooms_picture
from states_picture import picture as states_picture
from trust_page import page as trust_page

from diffbot_bag.tools.contract import BagRules, TopicRules
from diffbot_control.law.presets import PAPER, PRESETS
from diffbot_core.geometry import Pose
from diffbot_core.schema import Spec, parameters_of
from diffbot_lab.filter_benchmark import calibration as calibration_benchmark
from diffbot_lab.filter_benchmark import peer_report
from diffbot_lab.filter_benchmark import real_drives as real_benchmark
from diffbot_lab.filter_benchmark.real_calibration import calibrated_table
from diffbot_lab.paper.scenarios import SETTINGS
from diffbot_lab.targets import markdown_table
from diffbot_sim.feedback import EKF, RAW, TRUTH
from diffbot_sim.model.plant import PlantConfig
from diffbot_sim.model.sensors import SensorConfig
from diffbot_sim.model.simulator import WorldConfig
from diffbot_sim.reference_loop import simulate

DOCS = Path(__file__).parent
CHECK, PROVED = DOCS / "reference/bags/check.md", DOCS / "explanation/stability.md"
RUNS = 100
STEPS = 300
PAPER_PLANT = next(one.plant for one in SETTINGS if one.name == "raw")
QUIET = WorldConfig(
    plant=PlantConfig(drive_noise=0.0, encoder_noise=0.0),
    sensors=SensorConfig(eps_x_max=0.0, eps_y_max=0.0, eps_theta_max=0.0),
)


def check_page() -> str:
    """Return docs/reference/bags/check.md with the rules of contracts."""
    rows = [
        (part, f"`{one.name}`", one.spec.text + _choices(one.spec) + _unit(one.spec))
        for part, rules in (("bag", BagRules), ("topic", TopicRules))
        for one in parameters_of(rules)
    ]
    table = "\n".join(markdown_table(("of", "rule", "of what"), rows))
    return between_markers(CHECK.read_text(), "rules", table)


def _unit(spec: Spec) -> str:
    return "" if spec.unit in ("", "-") else f" [{spec.unit}]"


def _choices(spec: Spec) -> str:
    return f": {' or '.join(spec.choices)}" if spec.choices else ""


def filter_results_page() -> str:
    """Return docs/results/filter.md with the tables of the filter's benchmarks and of its contract."""
    results = read_data(LOCALIZATION)
    text = between_markers((RESULTS / "filter.md").read_text(), "conditions", filter_page.conditions(results))
    text = between_markers(text, "overview", filter_page.overview(results))
    text = between_markers(text, "colour", filter_page.colour(read_data(COLOUR)))
    text = between_markers(text, "states", filter_page.states(read_data(STATES)))
    return between_markers(text, "contract", filter_page.contract(read_data(CONTRACT)))


def real_robots_page() -> str:
    """Return docs/results/real-robots.md with the tables of real drives, and of calibrations on simulated ones."""
    text = (RESULTS / "real-robots.md").read_text()
    real, simulated = read_data(REAL), read_data(CALIBRATION)
    text = between_markers(text, "shipped", "\n\n".join(real_benchmark.table(one) for one in real["sets"]))
    text = between_markers(text, "calibrated", "\n\n".join(calibrated_table(one["calibrated"]) for one in real["sets"]))
    return between_markers(text, "simulated", calibration_benchmark.table(simulated))


def peer_page() -> str:
    """Return docs/results/robot-localization.md with the table of the comparison."""
    results = read_data(PEER)
    text = between_markers(
        (RESULTS / "robot-localization.md").read_text(), "conditions", peer_report.conditions(results)
    )
    return between_markers(text, "table", peer_report.table(results))


def real_ros_page() -> str:
    """Return docs/how-to/real-ros.md with what `make real` measured."""
    found = read_data("ros")
    rows = [
        (
            f"tf2_ros in {language}: `base_link` in `map` and `odom` at the stamps of poses and odometry",
            f"{one['lookups']} of {one['lookups']} found, after {one['worst wait']:.3f} s at most{how}; "
            f"equal to the messages to {one['worst difference']:.0e}",
        )
        for language, one, how in (
            ("Python", found["tf2 python"], ""),
            ("C++", found["tf2 c++"], " (question to answer of buffer_server's action)"),
        )
    ]
    for key in ("bags read by rosbag2", "bags of rosbag2 read by every command"):
        rows.append((key, f"{len(found[key])} kinds: {', '.join(found[key])}"))
    for key in ("goals on robot_localization's pose", "goals on AMCL's fixes"):
        error = f"the true pose within {found[key]['worst error']:.3f} m and rad"
        rows.append((key, f"{found[key]['reached']} of {found[key]['of']} reached, {error}"))
    return marked(DOCS / "how-to/real-ros.md", "figures", "\n".join(markdown_table(("what", "measured"), rows)))


def certificates_table() -> str:
    """Return the certificates: contract, claims, and what attacked them."""
    head = ("robot", "estimate", "base", "from", "r*", "T", "Omega_L ends within", "adversary", "random errors")
    rows = []
    for one in read_data(STABILITY)["certificates"]:
        contract, claims, seen = one["plan"]["contract"], one["certified"], one["observed"]
        robot, period = one["robot"], one["plan"]["period"]
        slopes = ""
        if contract["position_slope"] > 0.0:
            slopes = "; plus {position_slope:g} m, {theta_slope:g} rad, {sigma_slope:g} m per metre".format(**contract)
        if "kept" in one:
            share = "{runs:.1%} ({low:.1%} to {high:.1%})".format(**one["kept"])
            robot += f"; contract measured from {one['since']:g} s on, kept in {share} of other runs"
        rows.append(
            (
                f"{robot}; a pose each {period:g} s",
                "{eps_position:.3g} m, {eps_theta:.2g} rad, sigma {sigma_max:.2g} m".format(**contract) + slopes,
                "{eps_v:.2g} m/s, {eps_omega:.2g} rad/s".format(**contract),
                f"{claims['start']:.3g} m",
                f"{claims['radius']:.3f} m",
                f"{claims['time']:.1f} s",
                f"{claims['seed']:.3f} m",
                f"{one['adversary']['distance']:.3f} m, ratio {one['certified_over_adversary']:.2f}",
                f"there after {period * seen['longest']:.1f} s, at the end within {seen['farthest']:.3f} m",
            )
        )
    return "\n".join(markdown_table(head, rows))


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


def read_data(name: str) -> dict[str, Any]:
    """Return the kept results of this name."""
    content: dict[str, Any] = json.loads((DATA / f"{name}.json").read_text())
    return content


def results_pages() -> dict[Path, str]:
    """Return the pages that are made from the JSON files of docs/results, by their paths."""
    experiments = read_data("reproduction")
    law = benchmark_page(read_data("benchmark"), read_data("benchmark_bound"), read_data(EFFECTS))
    return {
        RESULTS / "benchmark.md": law,
        RESULTS / "reproduction.md": reproduction_page(experiments["a"], experiments["b"], experiments["scan"]),
        RESULTS / "docking.md": docking_page(read_data(DOCKING)),
        RESULTS / "filter.md": filter_results_page(),
        RESULTS / "real-robots.md": real_robots_page(),
        RESULTS / "robot-localization.md": peer_page(),
        RESULTS / "faults.md": faults_page(read_data("faults")),
        RESULTS / "performance.md": performance_page(read_data("performance")),
        RESULTS / "trust.md": trust_page(read_data("trust")),
        PROVED: marked(PROVED, "certificates", certificates_table()),
    }


def marked(path: Path, name: str, text: str) -> str:
    """Return the page with this text between the comments of this name."""
    return between_markers(path.read_text(), name, text)


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
        "--benchmark", nargs="?", choices=measure.WRITERS, const=measure.ALL, help="repeat those of law and filter"
    )
    parser.add_argument(
        "--real", type=Path, nargs="+", metavar="FOLDER", help="repeat those on the drives of data sets"
    )
    parser.add_argument("--peer", type=Path, metavar="RUNNER", help="repeat the comparison with robot_localization")
    parser.add_argument("--animation", action="store_true", help="draw run.gif and docking.gif again")
    parser.add_argument("--policy", action="store_true", help="write config/sros2_policy.xml from running nodes")
    options = parser.parse_args()
    if options.experiments:
        measure.write_experiments()
    for write in measure.WRITERS.get(options.benchmark, ()):
        write()
    if options.peer:
        measure.write_peer(options.peer)
    if options.real:
        measure.write_real(options.real)
    if options.animation:
        measure.write_animation()
    if options.policy:
        measure.write_policy()
    return check_or_write(options.check)


def check_or_write(check: bool) -> int:
    """Write the pages, or return 1 if one is out of date."""
    paper = DOCS / "explanation/law/paper.md"
    pages = {
        **parameter_tables.pages(),
        CHECK: check_page(),
        DOCS / "how-to/real-ros.md": real_ros_page(),
        **results_pages(),
        DOCS / "rooms.svg": rooms_picture(),
        DOCS / "reference/nodes/states.svg": states_picture(),
        **{DOCS / "badges" / name: picture for name, picture in badges().items()},
        DOCS / "explanation/geometry.svg": geometry_picture(),
        paper: marked(paper, "scenario A", scenario_a_table()),
    }
    stale = [path for path, text in pages.items() if not path.is_file() or path.read_text() != text]
    for path in stale:
        if check:
            print(f"{path.relative_to(DOCS.parent)} is out of date: run python docs/generate.py")
        else:
            path.write_text(pages[path])
            print(f"{path.relative_to(DOCS.parent)} written")
    return 1 if check and stale else 0


if __name__ == "__main__":
    sys.exit(main())
