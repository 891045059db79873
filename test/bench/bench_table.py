"""What the benchmark measures, against which targets, and its table."""

from __future__ import annotations

import statistics
from typing import Any, NamedTuple

RATIO, OURS = "ratio", "ours"


class BenchError(Exception):
    """Something could not be measured."""


class Pair(NamedTuple):
    """One round: this stack and, where there is one, the reference measured beside it."""

    ours: float
    reference: float | None


class Measure(NamedTuple):
    """One row of the table: a target is a bound of the ratio or of our own number; without one it is information."""

    key: str
    text: str
    unit: str
    target_of: str = RATIO
    at_most: float | None = None
    at_least: float | None = None

    @property
    def target(self) -> str:
        """The target in words."""
        unit = "x" if self.target_of == RATIO else self.unit
        if self.at_most is not None:
            return f"<= {self.at_most:g} {unit}"
        return f">= {self.at_least:g} {unit}" if self.at_least is not None else ""

    def is_met(self, value: float) -> bool | None:
        """Whether ``value`` keeps the target; None without one."""
        if self.at_most is not None:
            return value <= self.at_most
        return value >= self.at_least if self.at_least is not None else None


MEASURES = (
    Measure("clocked_1p_median", "50 Hz, one process: latency, median", "ms", at_most=1.0),
    Measure("clocked_1p_p99", "50 Hz, one process: latency, p99", "ms", at_most=1.2),
    Measure("clocked_1p_cpu", "50 Hz, one process: CPU of one core", "%", at_most=1.0),
    Measure("clocked_3p_median", "50 Hz, three processes: latency, median", "ms", at_most=1.0),
    Measure("clocked_3p_p99", "50 Hz, three processes: latency, p99", "ms", at_most=1.2),
    Measure("clocked_3p_cpu", "50 Hz, three processes: CPU of the two nodes", "%", at_most=1.0),
    Measure("robot_2p_median", "50 Hz, robot_node, driver apart: latency, median", "ms", at_most=0.85),
    Measure("robot_2p_p99", "50 Hz, robot_node, driver apart: latency, p99", "ms", at_most=1.0),
    Measure("robot_2p_cpu", "50 Hz, robot_node, driver apart: CPU of one core", "%", at_most=0.6),
    Measure(
        "robot_2p_inside", "robot_node: odometry's callback to cmd_vel sent, against two nodes", "ms", at_most=0.75
    ),
    Measure("lockstep_1p", "lock-step, one process", "steps/s", at_least=0.75),
    Measure("lockstep_1p_rate", "lock-step, one process: our rate", "steps/s", OURS, at_least=1200.0),
    Measure("lockstep_1p_events", "lock-step, one process, against relays on our executor", "steps/s"),
    Measure("lockstep_3p", "lock-step, three processes", "steps/s"),
    Measure("controller_step", "controller: step", "us", OURS, at_most=20.0),
    Measure("supervisor_on_pose", "controller: Supervisor.on_pose", "us"),
    Measure("ekf_step", "filter `ekf`: one fix and one odometry, against filterpy alone", "us", at_most=1.5),
    Measure("default_filter_step", "filter `ekf_calibrating`, the default: the same", "us", at_most=2.0),
    Measure("fnn_step", "filter `ekf_fnn`: the same", "us"),
    Measure("closed_loop_step", "closed loop without ROS: one step", "us"),
    Measure("start_controller", "controller: start to `ready`, against a bare rclpy node", "s", at_most=1.7),
    Measure("start_plant", "plant: the same", "s", at_most=1.7),
    Measure("start_recorder", "recorder: the same", "s", at_most=1.7),
    Measure("start_ekf", "ekf: the same", "s", at_most=2.2),
    Measure("start_robot", "robot_node with plant and recorder in one process: the same", "s"),
    Measure(
        "first_pose_ekf", "ekf with its state_file: start to its first pose at a subscriber", "s", OURS, at_most=1.5
    ),
    Measure(
        "memory_controller", "controller: resident memory when ready, against a bare rclpy node", "MB", at_most=1.3
    ),
    Measure("memory_plant", "plant: the same memory", "MB", at_most=1.3),
    Measure("memory_recorder", "recorder: the same memory", "MB", at_most=1.3),
    Measure("memory_ekf", "ekf: the same memory", "MB", at_most=1.5),
    Measure("memory_robot", "robot_node with plant and recorder: the same memory", "MB", at_most=2.4),
)
HEADER = ("measure", "ours", "reference", "ratio", "target", "met", "spread", "rounds")


class Row(NamedTuple):
    """Medians over the rounds; the ratio is the median of the ratios of each round."""

    measure: Measure
    ours: float
    reference: float | None
    ratio: float | None
    met: bool | None
    spread: tuple[float, float]
    """smallest and largest ratio of a round, or our smallest and largest number where there is no reference"""
    rounds: int

    def cells(self) -> tuple[str, ...]:
        """The row as text, in the order of HEADER."""
        unit = self.measure.unit
        return (
            self.measure.text,
            f"{_short(self.ours)} {unit}",
            "" if self.reference is None else f"{_short(self.reference)} {unit}",
            "" if self.ratio is None else f"{self.ratio:.2f}",
            self.measure.target,
            {True: "yes", False: "NO", None: ""}[self.met],
            " .. ".join(map(_short if self.ratio is None else "{:.2f}".format, self.spread)),
            str(self.rounds),
        )

    def as_dict(self) -> dict[str, Any]:
        """The row for bench.json."""
        values = self._asdict()
        del values["measure"]
        return {"key": self.measure.key, "unit": self.measure.unit, "target": self.measure.target, **values}


def _short(number: float) -> str:
    return f"{number:,.0f}" if number >= 1000 else f"{number:.3g}"


def make_row(measure: Measure, pairs: list[Pair]) -> Row:
    """Summarise the rounds of one measure, at least one."""
    ours = statistics.median(pair.ours for pair in pairs)
    references = [pair.reference for pair in pairs if pair.reference is not None]
    if references:
        each = [pair.ours / pair.reference for pair in pairs if pair.reference is not None]
        ratio = statistics.median(each)
        compared = ratio if measure.target_of == RATIO else ours
        met, reference = measure.is_met(compared), statistics.median(references)
        return Row(measure, ours, reference, ratio, met, (min(each), max(each)), len(pairs))
    each = [pair.ours for pair in pairs]
    return Row(measure, ours, None, None, measure.is_met(ours), (min(each), max(each)), len(pairs))


def make_rows(samples: dict[str, list[Pair]]) -> list[Row]:
    """Return the rows of all that was measured, in the order of MEASURES."""
    return [make_row(measure, samples[measure.key]) for measure in MEASURES if samples.get(measure.key)]


def text_table(rows: list[Row]) -> str:
    """Return the table for the terminal."""
    lines = [HEADER, *(row.cells() for row in rows)]
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    return "\n".join("  ".join(cell.ljust(width) for cell, width in zip(line, widths, strict=True)) for line in lines)


def markdown_table(rows: list[Row]) -> str:
    """Return the table for the docs."""
    lines = [HEADER, tuple("---" for _ in HEADER), *(row.cells() for row in rows)]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)
