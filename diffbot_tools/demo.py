"""The command ``diffbot demo``: run the graph as processes, drive to three goals, record and evaluate the run."""

from __future__ import annotations

import contextlib
import math
import os
import shutil
import subprocess
import time
from collections.abc import Callable, Iterator, Sequence
from importlib import import_module
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from tqdm import tqdm

from diffbot_control.goals.record import REACHED
from diffbot_control.law.goal_checker import GoalTolerance
from diffbot_control.law.registry import PRESETS, TUNED
from diffbot_core.errors import DiffbotError
from diffbot_core.files import is_bag_folder, output_folder, write_json
from diffbot_core.geometry import Pose
from diffbot_tools.bringup import LOCKSTEP
from diffbot_tools.plotting import BLUE, GREEN, GREY, ORANGE, RED, draw_heading, new_figure, save
from diffbot_tools.processes import NodeProcesses, PrivateDomain, graph_environment
from diffbot_tools.view.bag_source import BagRobot, BagRun, read_bag
from diffbot_tools.view.report_command import write_report
from diffbot_tools.view.results import GoalOutcome, is_reached

GOALS = (Pose(0.0, 0.0, 0.0), Pose(3.0, 2.0, math.pi / 2), Pose(1.0, -2.0, math.pi))
"""The goal of the paper's simulation A, then two more. The last goal is behind the robot."""
RECORDED_TOPICS = (
    "cmd_vel",
    "controller/goal_results",
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
_DEPTH = 1000
"""number of messages that a publisher keeps for a delayed recorder; no topic of the demonstration has more"""
_READY_TIMEOUT = 150.0
"""[s] time for all nodes to start; a busy computer is slow, and a node that ends is detected at once"""
_QUIET = 0.5
"""[s] time for which the graph must be complete, since a publisher and its subscriber discover each other separately"""
_PAUSE_TIMEOUT = 30.0
"""[s] time for the plant to answer"""
_BAR = "{desc:<28}{percentage:3.0f}%|{bar}| {elapsed}"
_RESULTS = ("summary.json", "path.png", "report.html")
"""Files that are written beside the bag."""
_STYLES: dict[str, dict[str, Any]] = {
    "fixes": {"label": "fixes (global_pose)", "color": GREY, "marker": ".", "markersize": 2.5, "linestyle": ""},
    "odometry": {"label": "odometry alone", "color": ORANGE, "linestyle": "--", "linewidth": 1.2},
    "truth": {"label": "truth", "color": BLUE, "linewidth": 2.6},
    "estimate": {"label": "estimate (EKF)", "color": RED, "linewidth": 0.9},
}
"""Styles of the curves of a BagRobot, in the order of drawing."""


class DemoOptions(NamedTuple):
    """Options of the command."""

    out: Path
    seed: int = 1
    real_time: bool = False
    overwrite: bool = False
    domain: int | None = None
    """ROS_DOMAIN_ID; None: a private domain"""
    preset: str = TUNED
    """preset of the controller"""
    watch: bool = False
    """run in real time, show the page, and keep running until an interrupt"""

    @property
    def clock(self) -> str:
        """Clock of the plant."""
        return "wall" if self.real_time or self.watch else "lockstep"

    @property
    def tolerance(self) -> GoalTolerance:
        """Tolerances of the preset. The true pose must be within them when a goal is answered."""
        tolerance: GoalTolerance = PRESETS[self.preset].config.tolerance
        return tolerance


def run_demo(options: DemoOptions) -> int:
    """Run the demonstration, print a table, and write bag, summary.json, path.png and report.html to ``options.out``.

    Returns:
        Exit status: 0, or 1 if a goal was not reached within the tolerances, after printing the reason.

    Raises:
        DiffbotError: if the output folder is in use or a node fails.
    """
    began = time.monotonic()
    folder = options.out
    with output_folder(folder):
        make_room_for_bag(folder / "bag", options.overwrite)
        (folder / "log").mkdir(exist_ok=True)
    with contextlib.ExitStack() as stack:
        domain = options.domain
        if domain is None:
            private = PrivateDomain()
            stack.callback(private.release)
            domain = private.id
        print(f"Graph on ROS_DOMAIN_ID {domain} (localhost), clock {options.clock}, seed {options.seed}")
        # The client is closed after the nodes: closing it drops messages that a slow reader has not received yet.
        client = stack.enter_context(_goal_client(domain))
        nodes = stack.enter_context(NodeProcesses(domain, folder / "log"))
        _start_nodes(options, folder, nodes)
        graph = _Graph(client, nodes)
        graph.drive(GOALS)
        if not options.watch:
            graph.pause(True)
        # The recorder stops last, so that it records the final messages of the other nodes.
        for name in ("recorder",) if options.watch else ("controller", "ekf", "plant", "recorder"):
            if status := nodes.stop(name):
                raise DiffbotError(f"{name} ended with status {status}: {nodes.last_log_line(name)}")
        status = _evaluate(options, folder, began)
        if options.watch:
            print("Draw goals on the page; the robot drives to them. Ctrl-C ends the demonstration.", flush=True)
            with contextlib.suppress(KeyboardInterrupt):
                while True:
                    time.sleep(0.2)
                    graph.check_nodes()
    return status


def make_room_for_bag(bag: Path, overwrite: bool) -> None:
    """Remove the bag of an earlier run and its results if ``overwrite`` is set.

    Raises:
        DiffbotError: if the bag exists and ``overwrite`` is not set, or the folder is not a bag.
    """
    if not bag.exists():
        return
    if not overwrite:
        raise DiffbotError(f"{bag} already exists: choose another folder with --out, or replace it with --overwrite")
    if not is_bag_folder(bag):
        raise DiffbotError(f"{bag} already exists and is not a bag: choose another folder with --out")
    shutil.rmtree(bag)
    for result in _RESULTS:  # old results would be misleading if the new run is interrupted
        (bag.parent / result).unlink(missing_ok=True)


@contextlib.contextmanager
def _goal_client(domain: int) -> Iterator[Any]:
    """Yield a goal client on the domain. Closing the client takes a bounded time."""
    os.environ.update(graph_environment(domain))
    # The middleware reads the environment when it is imported, and the command line must start without ROS.
    client = import_module("diffbot_control.ros.goals.client").GoalClient.in_own_context(node_name="demo")
    run = import_module("diffbot_core.ros.run")
    status = 1
    try:
        yield client
        status = 0
    finally:
        with run.forced_exit(run.END_TIMEOUT, status):
            client.close()


def _start_nodes(options: DemoOptions, folder: Path, nodes: NodeProcesses) -> None:
    is_lockstep = options.clock == "lockstep"
    time_source = {"use_sim_time": is_lockstep}
    depths = {f"qos_overrides./{topic}.publisher.depth": _DEPTH for topic in (*RECORDED_TOPICS, "clock")}
    common = {"reliable_inputs": is_lockstep, **time_source, **depths}
    uri = str((folder / "bag").resolve())
    nodes.start("recorder", "diffbot_bag.recorder_node", {"uri": uri, "topics": list(RECORDED_TOPICS), **time_source})
    plant = {"clock": options.clock, "seed": options.seed, "start_paused": True, **LOCKSTEP["plant"]}
    nodes.start("plant", "diffbot_sim.plant_node", {**plant, **depths})
    nodes.start("ekf", "diffbot_control.ekf_node", common)
    controller = {**LOCKSTEP["controller"], "preset": options.preset}
    nodes.start("controller", "diffbot_control.controller_node", {**controller, **common})
    if options.watch:
        page = {"port": 0, "open_browser": True, "record_folder": str((folder / "recorded").resolve())}
        watch = nodes.start("watch", "diffbot_tools.watch.watch_node", page, stdout=subprocess.PIPE)
        print((watch.stdout.readline() if watch.stdout else "").strip() or nodes.last_log_line("watch"), flush=True)


class _Graph:
    """The goal client and the nodes of the demonstration."""

    def __init__(self, client: Any, nodes: NodeProcesses) -> None:
        """Create the client of the service that pauses the plant."""
        self._client, self._nodes = client, nodes
        self._pause_type = import_module("std_srvs.srv").SetBool
        self._pause = client.create_client(self._pause_type, "plant/pause")

    def check_nodes(self) -> None:
        """Check that all nodes are running.

        Raises:
            DiffbotError: naming a node that has ended.
        """
        if failure := self._nodes.failed():
            raise DiffbotError(failure)

    def _wait_until(self, condition: Callable[[], Any], timeout: float) -> bool:
        def check() -> bool:
            self.check_nodes()
            return bool(condition())

        return bool(self._client.spin_until(check, timeout))

    def pause(self, paused: bool) -> None:
        """Pause or resume the plant.

        Raises:
            DiffbotError: if a node ends, or the plant does not answer.
        """
        future = self._pause.call_async(self._pause_type.Request(data=paused))
        if not self._wait_until(future.done, _PAUSE_TIMEOUT):
            raise DiffbotError(f"the plant did not answer within {_PAUSE_TIMEOUT:.0f} s")

    def drive(self, goals: Sequence[Pose]) -> None:
        """Drive to the goals one after the other; stop at the first one that is not reached.

        The first goal is sent before the plant's first step, so that a lock-step run is repeatable up to its answer.

        Raises:
            DiffbotError: if a node ends, or the graph is not ready after _READY_TIMEOUT.
        """
        with tqdm(total=100.0, desc="starting", bar_format=_BAR, disable=None) as bar:
            self._wait_until_ready()
            for number, goal in enumerate(goals):
                task = self._client.send_goal([goal], timeout=_READY_TIMEOUT)
                if number == 0:
                    self.pause(False)
                bar.set_description_str(f"goal {number + 1} of {len(goals)}", refresh=False)
                longest = 0.0
                while not self._client.wait_for_end(0.1):
                    self.check_nodes()
                    if task.feedback is not None:
                        longest = max(longest, task.feedback.distance_remaining)
                        share = 1.0 - task.feedback.distance_remaining / longest if longest else 0.0
                        bar.n = 100.0 * (number + share) / len(goals)
                        bar.refresh()
                if task.end != REACHED:
                    return

    def _wait_until_ready(self) -> None:
        """Wait until the nodes are connected and the recorder records all topics."""
        client = self._client
        status_type = import_module("diagnostic_msgs.msg").DiagnosticStatus
        latched = import_module("diffbot_core.ros.qos").LATCHED
        missing = {client.resolve_topic_name(topic) for topic in RECORDED_TOPICS}
        filter_states: list[Any] = []
        ready_since = math.inf

        def on_recorder(status: Any) -> None:
            missing.difference_update(*(pair.value.split() for pair in status.values if pair.key == "topics"))

        def is_ready() -> bool:
            nonlocal ready_since
            is_complete = (
                not missing
                and filter_states
                and client.is_ready()
                and client.count_subscribers("goal_pose") >= 2
                and self._pause.service_is_ready()
            )
            ready_since = min(ready_since, time.monotonic()) if is_complete else math.inf
            return time.monotonic() - ready_since >= _QUIET

        client.create_subscription(status_type, "recorder/status", on_recorder, latched)
        client.create_subscription(status_type, "ekf/status", filter_states.append, latched)
        if not self._wait_until(is_ready, _READY_TIMEOUT):
            topics = ", ".join(sorted(missing)) or "none"
            raise DiffbotError(
                f"the graph was not ready after {_READY_TIMEOUT:.0f} s; topics that are not recorded yet: {topics}"
            )


def _evaluate(options: DemoOptions, folder: Path, began: float) -> int:
    """Evaluate the bag, print the table and write the results; return the exit status."""
    run = read_bag(folder / "bag")
    (robot,) = run.robots
    reason = _reason(robot.outcomes, options)
    wall = time.monotonic() - began
    write_json(folder / "summary.json", _summary(options, run, reason, wall))
    _draw_run(robot, f"diffbot demo: preset {options.preset}, EKF in the loop", folder / "path.png")
    print(_table(robot.outcomes))
    print(f"{run.messages} messages recorded, {run.lost or 0} lost; {_duration(robot):.1f} s simulated in {wall:.1f} s")
    write_report(folder / "bag", folder / "report.html")
    print(f"Bag {folder / 'bag'}, figures {folder / 'summary.json'}, picture {folder / 'path.png'}")
    print(f"Report {folder / 'report.html'} (open it in a browser)")
    if reason:
        print(f"FAILED: {reason}")
    return 1 if reason else 0


def _duration(robot: BagRobot) -> float:
    return float(robot.curves["truth"]["t"][-1])


def _reason(outcomes: list[GoalOutcome], options: DemoOptions) -> str:
    """Return why the demonstration failed; empty if it succeeded."""
    xy, yaw = options.tolerance.xy_goal_tolerance, options.tolerance.yaw_goal_tolerance
    for number, one in enumerate(outcomes, 1):
        if not is_reached(one, PRESETS[options.preset].config):
            end = f"{one.end or 'not answered'}{f' ({one.reason})' if one.reason else ''}"
            off = f"{one.position_error:.3f} m and {one.heading_error:.3f} rad off, tolerance {xy} m and {yaw} rad"
            return f"goal {number} {end}: {off}"
    return "" if len(outcomes) == len(GOALS) else f"only {len(outcomes)} of {len(GOALS)} goals were sent"


def _table(outcomes: list[GoalOutcome]) -> str:
    head = f"{'goal (x, y, heading)':<24}{'end':<14}{'time [s]':>8}{'error [m]':>11}{'[deg]':>7}{'path [m]':>10}"
    head += f"{'direct [m]':>12}"
    rows = [head, "-" * len(head)]
    for one in outcomes:
        goal = f"({one.goal.x:.1f}, {one.goal.y:.1f}, {math.degrees(one.goal.theta):.0f} deg)"
        rows.append(
            f"{goal:<24}{one.end or 'no answer':<14}{one.time:>8.1f}{one.position_error:>11.3f}"
            f"{math.degrees(one.heading_error):>7.1f}{one.path_length:>10.2f}{one.direct_distance:>12.2f}"
        )
    rows.append("time: from the acceptance of the goal to the answer; error: of the true pose at the answer")
    return "\n".join(rows)


def _summary(options: DemoOptions, run: BagRun, reason: str, wall: float) -> dict[str, Any]:
    def plain(value: Any) -> Any:
        return None if isinstance(value, float) and math.isnan(value) else value

    (robot,) = run.robots
    goals = [{name: plain(value) for name, value in one._asdict().items()} for one in robot.outcomes]
    return {
        "seed": options.seed,
        "clock": options.clock,
        "preset": options.preset,
        "tolerance": {"xy": options.tolerance.xy_goal_tolerance, "yaw": options.tolerance.yaw_goal_tolerance},
        "success": not reason,
        "reason": reason,
        "messages": run.messages,
        "lost": run.lost or 0,
        "simulated_time": _duration(robot),
        "wall_time": wall,
        "goals": [one | {"goal": one["goal"]._asdict()} for one in goals],
    }


def _draw_run(robot: BagRobot, title: str, path: Path) -> None:
    """Draw truth, estimate, odometry, fixes and goals of a robot as a PNG."""
    figure, axes = new_figure(1, (8.0, 6.7))
    for name, style in _STYLES.items():
        if name in robot.curves:
            axes.plot(robot.curves[name]["x"], robot.curves[name]["y"], **style)
    truth = robot.curves["truth"]
    span = max(float(np.ptp(truth["x"])), float(np.ptp(truth["y"])), 1.0)
    poses = [("start", Pose(*(float(truth[name][0]) for name in ("x", "y", "theta"))))]
    poses += [(f"goal {number}", one.goal) for number, one in enumerate(robot.outcomes, 1)]
    for text, pose in poses:
        colour = BLUE if text == "start" else GREEN
        axes.plot([pose.x], [pose.y], "o", color=colour, markersize=6, zorder=5)
        draw_heading(axes, pose, 0.07 * span, colour)
        axes.annotate(text, (pose.x, pose.y), xytext=(6, -12), textcoords="offset points", color=colour, zorder=6)
    axes.set(xlabel="x [m]", ylabel="y [m]", title=title)
    axes.set_aspect("equal", adjustable="datalim")
    axes.legend(loc="best", fontsize="small")
    save(figure, path)
