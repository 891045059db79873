"""The page docs/results/performance.md from data/performance.json, and its rows for a terminal; see ``make bench``."""

from __future__ import annotations

from typing import Any

HEADER = ("measure", "ours", "reference", "ratio", "target", "met", "spread", "rounds")
QUESTION = """\
# Performance

How much time, CPU and memory do nodes, simulation, bags and the page in the browser need?"""
METHOD = """\
    make bench                          # all parts: measures, and writes this page
    make bench ARGS="--quick lockstep"  # a short form; single parts go to out/bench.json

All figures are of one run of one commit. Machines differ, so ratios (ours / reference) say more than absolute times.
Figures are medians over the rounds. Shown is what has a target, and the target where it is
missed. Other measures, spreads and rounds: [performance.json](data/performance.json). The nodes use
rclpy's EventsExecutor (`DIFFBOT_EXECUTOR=single`: its default one) and read frequent messages from their bytes."""
SECTIONS = {
    "latency": (
        "Nodes at 50 Hz",
        """\
Odometry at 50 Hz, fixes at 10 Hz. The latency runs from the start of the driver's step to its callback for the command.
The reference is two plain rclpy relays, Odometry -> Odometry -> Twist, which compute nothing. The CPU of *one process*
includes the driver. robot_node is filter and controller in one process.""",
    ),
    "lockstep": ("Lock-step", "Noise, /clock and one fix in each step. The reference is three bare nodes."),
    "batch": ("Compiled closed loop", "Simulation A of the paper without ROS, 300 steps a run."),
    "campaign": ("Campaigns", "`diffbot campaign` with the default law and filter."),
    "recorder": ("Recorder", "Eight topics, together 8000 messages a second of 300 bytes in the mean."),
    "replay": ("Replay", "20,000 messages of one topic, recorded at 1 kHz, to a subscriber in Python."),
    "repair": ("Repair", "Includes a check by two readers. What a killed recorder loses: [Faults](faults.md)."),
    "cut": ("Cut and join", "A bag of 2 GiB (650 s; messages of 20 kB in the mean, zstd); merges on an eighth of it."),
    "page": (
        "Page in the browser",
        """\
Five topics at 50 Hz with noise in every number; Chromium draws without a graphics card. The control period is that of
the driver above in three processes while a [live page](../reference/browser/live.md) is open.""",
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


def _line(row: dict[str, Any]) -> str:
    """Return a measure as a line of a list, with its target if it misses that."""
    text, ours, reference, ratio, target, *_ = cells(row)
    missed = "" if row["met"] else f" **(target {target})**"
    return f"- {text}: {ours}" + (f", reference {reference}, ratio {ratio}" if ratio else "") + missed


def _short(number: float) -> str:
    return f"{number:,.0f}" if number >= 1000 else f"{number:.3g}"


def page(content: dict[str, Any]) -> str:
    """Return the page; ``content`` is what the JSON file holds."""
    parts = [QUESTION, _answer(content), METHOD, _conditions(content)]
    for name, (title, text) in SECTIONS.items():
        rows = [row for row in content["parts"][name]["rows"].values() if row["met"] is not None]
        parts += [f"## {title}", text, "\n".join(map(_line, rows))]
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
