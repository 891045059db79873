"""``diffbot demo``: run the graph as separate processes, record it, and evaluate the bag's ground truth."""

from __future__ import annotations

import contextlib
import json
import math
import os
import shutil
import subprocess
import threading
import time
from pathlib import Path
from typing import Any, NamedTuple

from tqdm import tqdm

from diffbot_bag.bag.file_lock import locked_files
from diffbot_bag.bag.writer import is_unfinished
from diffbot_control.law.presets import PRESETS, TUNED
from diffbot_core.errors import DiffbotError
from diffbot_core.files import write_json
from diffbot_core.geometry import Pose
from diffbot_tools.demo.figure import draw_run
from diffbot_tools.demo.processes import NodeProcesses, PrivateDomain, wait_until
from diffbot_tools.demo.run_record import GoalResult, RunRecord, evaluate, read_run
from diffbot_tools.view.report_command import write_report

GOALS = (Pose(0.0, 0.0, 0.0), Pose(3.0, 2.0, math.pi / 2), Pose(1.0, -2.0, math.pi))
"""The goal of the paper's simulation A, then two others; the last one lies behind the robot."""
RECORDED_TOPICS = (
    "cmd_vel",
    "controller/navigation",
    "controller/status",
    "ekf/status",
    "global_pose",
    "goal_pose",
    "ground_truth",
    "joint_states",
    "odom",
    "odometry/filtered",
    "pose",
)
_KEPT = 1000
"""messages that each publisher keeps for a recorder that is held up: more than a drive has of one topic"""
_READY_TIMEOUT = 150.0
"""[s] a busy machine starts six processes slowly; one that ends is noticed at once"""
_BAR = "{desc:<28}{percentage:3.0f}%|{bar}| {elapsed}"


class DemoOptions(NamedTuple):
    """Flags of the command."""

    out: Path
    seed: int = 1
    real_time: bool = False
    overwrite: bool = False
    domain: int | None = None
    """ROS_DOMAIN_ID; None: a private one"""
    preset: str = TUNED
    """of the controller; the end poses must be within its tolerances"""
    watch: bool = False
    """run in real time, show the page, and go on until an interrupt"""


def run_demo(options: DemoOptions) -> int:
    """Run the demonstration, print a table, and write bag, summary.json, path.png and report.html to ``options.out``.

    Returns:
        0, or 1 after printing the reason if a true end pose is not within the tolerances.

    Raises:
        DiffbotError: if the output folder is in use or a node fails.
    """
    options = options._replace(real_time=options.real_time or options.watch)
    folder = _output_folder(options)
    began = time.monotonic()
    domain = PrivateDomain() if options.domain is None else None
    number = options.domain if domain is None else domain.id
    print(f"Graph on ROS_DOMAIN_ID {number} (localhost), clock {_clock(options)}, seed {options.seed}")
    try:
        with NodeProcesses(int(number or 0), folder / "log") as nodes:
            _drive(options, folder, nodes)
            status = _evaluate(options, folder, began)
            if options.watch:
                _stay(nodes)
    finally:
        if domain is not None:
            domain.release()
    return status


def _evaluate(options: DemoOptions, folder: Path, began: float) -> int:
    """Evaluate the bag, print the table and write the results; return the exit status."""
    record = read_run(folder / "bag")
    results = evaluate(record, *_tolerances(options))
    reason = _reason(results, *_tolerances(options))
    wall = time.monotonic() - began
    _write_summary(folder, options, record, results, reason, wall)
    draw_run(record, f"diffbot demo: preset {options.preset}, EKF in the loop", folder / "path.png")
    print(_table(results))
    simulated = float(record.truth[-1, 0])
    print(f"{record.messages} messages recorded, {record.lost} lost; {simulated:.1f} s simulated in {wall:.1f} s")
    write_report(folder / "bag", folder / "report.html")
    print(f"Bag {folder / 'bag'}, figures {folder / 'summary.json'}, picture {folder / 'path.png'}")
    print(f"Report {folder / 'report.html'} (open it in a browser)")
    if reason:
        print(f"FAILED: {reason}")
    return 1 if reason else 0


def _tolerances(options: DemoOptions) -> tuple[float, float]:
    tolerance = PRESETS[options.preset].tolerance
    return tolerance.xy_goal_tolerance, tolerance.yaw_goal_tolerance


def _clock(options: DemoOptions) -> str:
    return "wall" if options.real_time else "lockstep"


def _output_folder(options: DemoOptions) -> Path:
    folder = options.out
    try:
        _make_room_for_bag(folder / "bag", options.overwrite)
        (folder / "log").mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise DiffbotError(f"cannot write to {folder}: {error.strerror}") from None
    if not os.access(folder, os.W_OK):
        raise DiffbotError(f"cannot write to {folder}")
    return folder


def _make_room_for_bag(bag: Path, overwrite: bool) -> None:
    if not bag.exists():
        return
    if not overwrite:
        raise DiffbotError(f"{bag} exists: choose another folder with --out, or replace it with --overwrite")
    if not bag.is_dir() or not ((bag / "metadata.yaml").is_file() or is_unfinished(bag)):
        raise DiffbotError(f"{bag} exists and is no bag: not replaced")
    with locked_files(bag.glob("*.mcap")):
        shutil.rmtree(bag)
    for result in (
        "summary.json",
        "path.png",
        "report.html",
    ):  # of the old run: misleading if the new one is interrupted
        (bag.parent / result).unlink(missing_ok=True)


def _drive(options: DemoOptions, folder: Path, nodes: NodeProcesses) -> None:
    """Run the graph until the demo node ends; after it, only what the page needs goes on."""
    demo = _start_nodes(options, folder, nodes)
    _follow(demo, nodes)
    # The recorder stops last: it records the final messages of the others.
    for name in ("recorder",) if options.watch else ("controller", "ekf", "plant", "recorder"):
        status = nodes.stop(name)
        if status != 0:
            raise DiffbotError(f"{name} ended with status {status}: {nodes.last_log_line(name)}")


def _start_nodes(options: DemoOptions, folder: Path, nodes: NodeProcesses) -> subprocess.Popen[str]:
    """Start all nodes; return the one that sends the goals."""
    simulated = {"use_sim_time": not options.real_time}
    goals = [float(number) for goal in GOALS for number in goal]
    nodes.start(
        "recorder",
        "diffbot_bag.recorder_node",
        {"uri": str((folder / "bag").resolve()), "topics": list(RECORDED_TOPICS), **simulated},
    )
    kept = {f"qos_overrides./{topic}.publisher.depth": _KEPT for topic in (*RECORDED_TOPICS, "clock")}
    plant = {"clock": _clock(options), "seed": options.seed, "start_paused": True, **kept}
    nodes.start("plant", "diffbot_sim.plant_node", plant)
    lockstep = {"reliable_inputs": _clock(options) == "lockstep"}
    nodes.start("ekf", "diffbot_control.ekf_node", {**lockstep, **simulated, **kept})
    nodes.start(
        "controller",
        "diffbot_control.controller_node",
        {"publish_when_idle": True, "preset": options.preset, **lockstep, **simulated, **kept},
    )
    if options.watch:
        page = nodes.start(
            "watch",
            "diffbot_tools.watch.watch_node",
            {"port": 0, "open_browser": True, "record_folder": str((folder / "recorded").resolve())},
            stdout=subprocess.PIPE,
        )
        print((page.stdout.readline() if page.stdout else "").strip() or nodes.last_log_line("watch"), flush=True)
    parameters = {"goals": goals, "recorded_topics": list(RECORDED_TOPICS), "pause_at_end": not options.watch}
    return nodes.start("demo", "diffbot_tools.demo.demo_node", parameters, stdout=subprocess.PIPE)


def _stay(nodes: NodeProcesses) -> None:
    """Leave robot and page running until an interrupt.

    Raises:
        DiffbotError: if a node ends.
    """
    nodes.stop("demo")
    print("The robot is yours: draw goals on the page. Ctrl-C ends it.", flush=True)
    failure = ""
    with contextlib.suppress(KeyboardInterrupt):
        while not failure:
            time.sleep(0.2)
            failure = nodes.failed()
    if failure:
        raise DiffbotError(failure)


def _follow(demo: subprocess.Popen[str], nodes: NodeProcesses) -> None:
    """Show the demo node's progress until it ends."""
    progress: dict[str, Any] = {"phase": "starting", "progress": 0.0, "missing": []}
    reader = threading.Thread(target=_read_progress, args=(demo, progress), daemon=True)
    reader.start()
    ready_by = time.monotonic() + _READY_TIMEOUT
    with tqdm(total=100.0, desc="starting", bar_format=_BAR, disable=None) as bar:

        def ended() -> bool:
            bar.set_description_str(progress["phase"], refresh=False)
            bar.n = 100.0 * progress["progress"]
            bar.refresh()
            waiting = progress["phase"] in ("starting", "waiting for the graph", "waiting for the controller")
            if waiting and time.monotonic() > ready_by:
                missing = ", ".join(progress["missing"]) or "nothing named"
                raise DiffbotError(f"the graph was not ready after {_READY_TIMEOUT:.0f} s; not recorded yet: {missing}")
            failure = nodes.failed()
            if failure and demo.poll() is None:
                raise DiffbotError(failure)
            return demo.poll() is not None

        wait_until(ended, math.inf, poll=0.1)
        reader.join(timeout=5.0)
        ended()
    if demo.returncode not in (0, 2):  # 2: a goal was not reached; the table shows it
        raise DiffbotError(f"the demo node ended with status {demo.returncode}: {nodes.last_log_line('demo')}")


def _read_progress(demo: subprocess.Popen[str], progress: dict[str, Any]) -> None:
    for line in demo.stdout or ():
        progress.update(json.loads(line))


def _reason(results: list[GoalResult], xy: float, yaw: float) -> str:
    """Return why the demonstration failed; empty if it did not."""
    if len(results) < len(GOALS):
        return f"only {len(results)} of {len(GOALS)} goals were driven to"
    for number, result in enumerate(results, 1):
        if math.isnan(result.metrics.settling_time):
            return (
                f"goal {number} not reached: {result.metrics.position_error:.3f} m and "
                f"{result.metrics.heading_error:.3f} rad off, tolerance {xy} m and {yaw} rad"
            )
    return ""


def _table(results: list[GoalResult]) -> str:
    head = (
        "goal (x, y, heading)      true final x [m]   y [m]  heading [rad]"
        "  error [m]  settled [s]  path [m]  direct [m]"
    )
    rows = [head, "-" * len(head)]
    for result in results:
        goal, metrics = result.goal, result.metrics
        place = f"({goal.x:.1f}, {goal.y:.1f}, {math.degrees(goal.theta):.0f} deg)"
        x, y, theta = metrics.final
        rows.append(
            f"{place:<24}{x:>18.4f}{y:>8.4f}{theta:>15.4f}{metrics.position_error:>11.4f}"
            f"{metrics.settling_time:>13.1f}{metrics.path_length:>10.2f}{metrics.direct_distance:>12.2f}"
        )
    rows.append("(final poses in each goal's frame; 0, 0, 0 is exact)")
    return "\n".join(rows)


def _write_summary(
    folder: Path,
    options: DemoOptions,
    record: RunRecord,
    results: list[GoalResult],
    reason: str,
    wall: float,
) -> None:
    summary = {
        "seed": options.seed,
        "clock": _clock(options),
        "preset": options.preset,
        "tolerance": dict(zip(("xy", "yaw"), _tolerances(options), strict=True)),
        "success": not reason,
        "reason": reason,
        "messages": record.messages,
        "lost": record.lost,
        "simulated_time": float(record.truth[-1, 0]),
        "wall_time": wall,
        "goals": [
            {
                "goal": result.goal._asdict(),
                "final_in_goal_frame": result.metrics.final._asdict(),
                "position_error": result.metrics.position_error,
                "heading_error": result.metrics.heading_error,
                "settling_time": None if math.isnan(result.metrics.settling_time) else result.metrics.settling_time,
                "path_length": result.metrics.path_length,
                "direct_distance": result.metrics.direct_distance,
                "estimation_error": result.estimation_error,
            }
            for result in results
        ],
    }
    write_json(folder / "summary.json", summary, indent=2)
