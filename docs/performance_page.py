"""The page docs/results/performance.md from data/performance.json: both are written by ``make bench``."""

from __future__ import annotations

from typing import Any

from diffbot_lab.targets import markdown_table

HEADER = ("measure", "ours", "reference", "ratio", "target", "met", "spread", "rounds")
QUESTION = """\
# Performance

How much time, CPU and memory do nodes, simulation, bags and the page in the browser need?"""
METHOD = """\
    make bench                          # all parts: measures, and writes this page
    make bench ARGS=--quick             # a short form of each part: does it run?
    make bench ARGS="lockstep cut"      # single parts, to out/bench.json

All figures are of one run of one commit. Machines and their load differ, so ratios say more than absolute times. Each
round measures this project and its reference in succession, where processes are started in alternating order. *Ratio*
is the median over the rounds of ours / reference; *ours* and *reference* are medians over the rounds; *spread* is the
smallest and largest ratio of a round, or figure where there is no reference. Missed targets are marked NO. On a busy
machine p99, what runs on two cores, and what waits for the disk are worse. Why the nodes are fast is in
[Design for speed](../explanation/speed.md). All figures: [performance.json](data/performance.json)."""
SECTIONS = {
    "latency": (
        "Nodes at 50 Hz",
        """\
A driver publishes odometry at 50 Hz and a pose fix at 10 Hz, and subscribes to the command. The latency runs from the
start of its step, before it fills its messages, to its callback for the command. Ours are filter and controller with
all checks and diagnostics, on the executor of `diffbot_core.ros.node`. The reference is two plain rclpy relays,
Odometry -> Odometry -> Twist, which compute nothing, on the default executor. The driver is the same on both sides; in
*one process* CPU counts it, too. A round in which a command is lost is repeated. robot_node is filter and controller in
one process, where the pose is handed over by a call; its last row compares it with two nodes that exchange the pose
over DDS.""",
    ),
    "lockstep": (
        "Lock-step",
        """\
The plant takes its next step when the command of the present step has come: noise, /clock and one fix in each step. The
reference passes a number around three bare nodes that reuse their messages and have neither parameter services nor
rosout.""",
    ),
    "batch": (
        "Compiled closed loop",
        """\
Simulation A of the paper without ROS, 300 steps a run. The kernel written by hand does this one case with plain
numbers; its results are the same.""",
    ),
    "campaign": ("Campaigns", "`diffbot campaign` with the default law and filter, from its start to its end."),
    "recorder": (
        "Recorder",
        """\
Eight topics of a robot, together 8000 messages a second of 300 bytes in the mean. The bare subscriber receives the same
messages at the same time and only counts them. The longest times are of runs in which the recorder alone receives; they
include waiting for a core.""",
    ),
    "replay": ("Replay", "20,000 messages of one topic, recorded at 1 kHz, to a subscriber in Python."),
    "repair": (
        "Repair",
        """\
Recordings that were not finished. The repair includes a check by two readers. How much a killed recorder loses is in
[Faults](faults.md).""",
    ),
    "cut": (
        "Cut and join",
        """\
A bag of 2 GiB (650 s; messages of 20 kB in the mean, zstd). Merges are compared in CPU time, on an eighth of the
bags.""",
    ),
    "page": (
        "Page in the browser",
        """\
The bag of the [report](../reference/browser/report.md) has truth, estimate, odometry, fixes and commands at 50 Hz,
with noise in every number; Chromium draws without a graphics card. Control period and latency are those of the driver
above in three processes, while a [live page](../reference/browser/live.md) is open.""",
    ),
}


def cells(row: dict[str, Any]) -> tuple[str, ...]:
    """Return a row as text, in the order of HEADER."""
    ratio, unit = row["ratio"], f" {row['unit']}".rstrip()
    return (
        row["text"],
        f"{_short(row['ours'])}{unit}",
        "" if row["reference"] is None else f"{_short(row['reference'])}{unit}",
        "" if ratio is None else f"{ratio:.2f}",
        row["target"],
        {True: "yes", False: "NO", None: ""}[row["met"]],
        "" if row["rounds"] == 1 else " .. ".join(map(_short if ratio is None else "{:.2f}".format, row["spread"])),
        str(row["rounds"]),
    )


def _short(number: float) -> str:
    return f"{number:,.0f}" if number >= 1000 else f"{number:.3g}"


def page(content: dict[str, Any]) -> str:
    """Return the page; ``content`` is what the JSON file holds."""
    parts = [QUESTION, _answer(content), METHOD, _conditions(content)]
    for name, (title, text) in SECTIONS.items():
        rows = content["parts"][name]["rows"].values()
        parts += [f"## {title}", text, "\n".join(markdown_table(HEADER, map(cells, rows)))]
    return "\n\n".join(parts) + "\n"


def _conditions(content: dict[str, Any]) -> str:
    """Say what was measured, when, where and under which load."""
    changed = " with uncommitted changes" if content["changed"] else ""
    load = ", ".join(f"{one:.1f}" for one in content["load"])
    versions = ", ".join(f"{name} {version}" for name, version in content["versions"].items())
    return (
        f"Commit {content['commit']}{changed}, {content['date']}; {content['cores']} x {content['processor']}, "
        f"{content['memory']:g} GB; {content['seconds'] / 60:.0f} minutes.\n"
        f"Load average before the run (1, 5 and 15 minutes): {load}.\nVersions: {versions}."
    )


def _answer(content: dict[str, Any]) -> str:
    rows = {name: part["rows"] for name, part in content["parts"].items()}
    judged = [row["met"] for part in rows.values() for row in part.values() if row["met"] is not None]
    one, three = (rows["latency"][f"{name}_median"] for name in ("one", "three"))
    steps, filtered, trim = rows["lockstep"]["one_rate"], rows["batch"]["filter"], rows["cut"]["trim"]
    busy = content["load"][0] > 0.5 * content["cores"]
    where = f", on a busy machine (load average {content['load'][0]:.1f} on {content['cores']} cores)" if busy else ""
    return (
        f"**In short:** filter and law answer an odometry message within {one['ours']:.1f} ms in one process, "
        f"{one['ratio']:.2f} times the latency of relays\n"
        f"that compute nothing, and within {three['ours']:.1f} ms in three processes, {three['ratio']:.2f} times. "
        f"Lock-step does {steps['ours']:,.0f} steps a second, the\n"
        f"compiled loop with the filter {filtered['ours']:.1f} million. Ten seconds are cut out of 2 GiB in "
        f"{trim['ours']:.1f} s.\n{sum(judged)} of {len(judged)} targets are met{where}."
    )
