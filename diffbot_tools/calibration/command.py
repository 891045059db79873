"""``diffbot calibrate``: estimate parameters of ekf and controller from recorded drives without a ground truth."""

from __future__ import annotations

import math
import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from diffbot_control.ros.messages.fields import stamp_ns
from diffbot_control.ros.parameters.ekf import EkfNodeConfig
from diffbot_core.errors import BadMessageError, DiffbotError
from diffbot_core.files import write_text
from diffbot_core.stamps import S_PER_NS
from diffbot_tools.calibration.calibrate import Calibration, HeldOutFigures, calibrate
from diffbot_tools.calibration.calibrated_file import calibrated_file
from diffbot_tools.calibration.events import Array, EventReader, Events
from diffbot_tools.calibration.latency import LatencyEstimate, latency_of
from diffbot_tools.calibration.parameters import CalibrationResult, result_of
from diffbot_tools.opened_bag import open_bag
from diffbot_tools.parameter_file import read_config
from diffbot_tools.refilter import inputs_of, parameter_file_of, topics_of

COMMANDS = "/cmd_vel"


def run(bags: list[Path], params: Path | None, out: Path, until: float, remap: dict[str, str]) -> int:
    """Calibrate, write the parameter file and print the tables.

    Args:
        bags: bags of one robot, folders or .mcap files.
        params: ROS parameter file; None for ``ekf.yaml`` in the folder of the first bag.
        out: parameter file to write.
        until: length [s] of each drive to use, from its first odometry message.
        remap: topic in the bags for cmd_vel, and for each input of the filter, that has another name in the bags.

    Raises:
        DiffbotError: if a file or topic is missing, a parameter is not allowed, ``out`` exists already, or the drives
            are too short.
    """
    if os.path.lexists(out):
        raise DiffbotError(f"{out} exists already: choose another name for the parameter file")
    if not out.absolute().parent.is_dir():
        raise DiffbotError(f"{out.parent} is not a folder: {out.name} cannot be written")
    given = parameter_file_of(bags[0], params)
    config = read_config(given)
    drives, commands = zip(*(read_drive(bag, config, until, remap) for bag in bags), strict=True)
    with tqdm(desc="calibrate", unit="run", disable=None) as bar:

        def on_phase(text: str) -> None:
            """Print the text above the progress bar."""
            bar.write(f"calibrate: {text}", file=sys.stderr)

        calibration = calibrate(list(drives), config, bar.update, on_phase)
    result = result_of(calibration, config)
    delay = float(result.parameters["odometry_delay"])
    latency = _latency(list(drives), list(commands), delay)
    head = f"Calibrated from {', '.join(bag.absolute().name for bag in bags)} by diffbot calibrate."
    write_text(out, calibrated_file(given, config, result, latency, head))
    print(describe(calibration, result, latency))
    print(out)
    return 0


def read_drive(bag: Path, config: EkfNodeConfig, until: float, remap: dict[str, str]) -> tuple[Events, Array]:
    """Return the events of a bag, and its velocity commands (n, 3): time [s], v, omega. The bag may have no commands.

    Raises:
        DiffbotError: if the bag cannot be read or the drive is too short.
    """
    with open_bag(bag) as reader:
        names = topics_of(reader, config, {name: topic for name, topic in remap.items() if name != "cmd_vel"})
        _check_measured(bag, config, names)
        collected = EventReader(config, names)
        recorded, commanded = reader.topics, "/" + remap.get("cmd_vel", COMMANDS).lstrip("/")
        if "cmd_vel" in remap and commanded not in recorded:
            raise DiffbotError(f"{bag} has no topic {commanded} for cmd_vel")
        topics = (*collected.topics, commanded) if commanded in recorded else collected.topics
        total = sum(recorded[topic].message_count for topic in topics)
        rows = []
        for message in tqdm(reader.decoded(topics), desc=bag.name, total=total, unit="message", disable=None):
            if message.topic == commanded:
                rows.append(_command(message))
            else:
                collected.take(message)
    events = collected.events(str(bag), until)
    for (topic, kind), count in sorted(collected.dropped.items()):
        print(f"{bag}: {topic}: dropped {count}: {kind}", file=sys.stderr)
    commands = np.array([row for row in rows if row is not None], dtype=np.float64).reshape(-1, 3)
    commands[:, 0] -= events.zero * S_PER_NS
    return events, commands[np.argsort(commands[:, 0], kind="stable")]


def _check_measured(bag: Path, config: EkfNodeConfig, names: dict[str, str]) -> None:
    """Check that a bag contains measurements of the pose.

    Raises:
        DiffbotError: if it contains no measurements. The text names the topics and types that the calibration can use.
    """
    types = inputs_of(config)
    sources = config.localization.sources.pose_sources
    known = ("global_pose", *sources, "heading", *(("landmarks",) if config.landmarks.landmark_ids else ()))
    if set(known).isdisjoint(names.values()):
        wanted = ", ".join(f"{name} ({types[name]})" for name in known)
        note = "" if config.landmarks.landmark_ids else "; landmarks need their map in the parameters (landmark_ids)"
        raise DiffbotError(
            f"{bag} contains no pose measurements: record one of {wanted}, or name its topic with --remap{note}"
        )


def _command(message: Any) -> tuple[float, float, float] | None:
    """Return time [s], v and omega of a TwistStamped, or of a Twist at its log time; None for any other message."""
    content = message.content
    try:
        twist = getattr(content, "twist", content)
        time = stamp_ns(content.header.stamp) if hasattr(content, "header") else message.log_time
        row = time * S_PER_NS, float(twist.linear.x), float(twist.angular.z)
    except (AttributeError, BadMessageError):
        return None
    return row if all(map(math.isfinite, row)) else None


def _latency(drives: list[Events], commands: list[Array], delay: float) -> LatencyEstimate | None:
    """Return the most certain latency estimate of all drives; None if no drive determines the latency."""
    found = [latency_of(rows, one.odometry, delay) for one, rows in zip(drives, commands, strict=True)]
    known = [one for one in found if one is not None and math.isfinite(one.sigma)]
    return min(known, key=lambda one: one.sigma, default=None)


def describe(calibration: Calibration, result: CalibrationResult, latency: LatencyEstimate | None) -> str:
    """Return the tables as text."""
    lines = [f"{'':28}{'before':>12}{'after':>12}{'deviation':>12}"]
    for row in result.rows:
        lines.append(f"{row.name:28}{row.before:12.4g}{row.after:12.4g}{row.deviation:>12}  {row.note}".rstrip())
    if latency is not None:
        lines.append(f"{'command_latency':28}{'':12}{latency.dead_time:12.3f}{latency.sigma:12.2g}")
        lines.append(f"{'drive_time_constant':28}{'':12}{latency.time_constant:12.3f}")
        lines += [f"{name:28}{'':12}{limit:12.4g}" for name, limit in latency.limits().items()]
    lines += ["", f"{'held-out half':28}{'before':>12}{'after':>12}"]
    figures: tuple[tuple[str, str, Callable[[HeldOutFigures], float]], ...] = (
        ("log likelihood per number", ".3f", lambda one: one.log_likelihood),
        ("NIS per number (ideal: 1)", ".3f", lambda one: one.consistency.nis),
        ("whiteness, lag 1 (ideal: 0)", "+.3f", lambda one: one.consistency.correlation),
        ("  95 % bound if white, +-", ".3f", lambda one: one.consistency.bound),
    )
    for title, form, value in figures:
        before, after = (format(value(one), form) for one in (calibration.before, calibration.after))
        lines.append(f"{title:28}{before:>12}{after:>12}")
    undetermined = list(result.undetermined)
    if latency is None:
        remedy = f"record {COMMANDS}, and change its speeds abruptly"
        undetermined += [(name, remedy) for name in ("command_latency", "drive_time_constant")]
    if undetermined:
        lines += ["", "Not determined by the drives, kept as given:"]
        lines += [f"  {name}: {manoeuvre}" for name, manoeuvre in undetermined]
    return "\n".join(lines)
