"""Speed of this stack beside bare relays and bare filterpy: ``make bench``, or ``python test/bench/bench.py``.

Machines are shared and noisy, so what counts are ratios: each round measures both sides right after each
other, the figure is the median of the rounds' ratios, and the spread of the rounds stands beside it. A
missed target is reported and is no error (except with --strict); the exit status is 1 if something
could not be measured. Ctrl-C ends with what is done so far.
"""

from __future__ import annotations

import argparse
import os
import platform
import sys
import tempfile
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import NamedTuple

from bench_graph import ONE, THREE, TWO, Chains, clocked_round, lockstep_round, robot_round
from bench_start import NODES, first_pose_round, start_round
from bench_steps import steps_round
from bench_table import BenchError, Pair, Row, make_rows, markdown_table, text_table
from tqdm import tqdm

from diffbot_core.files import write_json, write_text
from diffbot_lab.demo.processes import PrivateDomain

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs" / "results" / "performance" / "index.md"
BEGIN, END = "<!-- bench -->", "<!-- /bench -->"
PARTS = ("clocked", "robot", "lockstep", "steps", "start")


class Effort(NamedTuple):
    """Rounds and seconds per turn."""

    clocked: tuple[int, float]
    robot: tuple[int, float]
    lockstep: tuple[int, float]
    steps: int
    start: int


FULL = Effort(clocked=(5, 2.5), robot=(7, 4.0), lockstep=(4, 1.0), steps=40, start=7)
QUICK = Effort(clocked=(1, 1.2), robot=(1, 1.2), lockstep=(1, 0.6), steps=5, start=1)

Job = tuple[str, Callable[[], dict[str, Pair]]]


def plan(chains: Chains, effort: Effort, parts: list[str]) -> list[Job]:
    """List the rounds in the order in which they are run; a job measures one round of one scenario."""
    jobs: list[Job] = []
    if "steps" in parts:
        jobs += [("steps", partial(steps_round, number)) for number in range(effort.steps)]
    if "start" in parts:
        jobs += [
            ("start", partial(start_round, name, chains.environment, chains.folder, number))
            for number in range(effort.start)
            for name in NODES
        ]
        jobs += [("first pose", partial(first_pose_round, chains.environment, chains.folder))] * effort.start
    one_and_three = (("1p", ONE), ("3p", THREE))
    for part, function, variants in (
        ("clocked", clocked_round, one_and_three),
        ("robot", robot_round, (("2p", TWO),)),
        ("lockstep", lockstep_round, one_and_three),
    ):
        rounds, seconds = getattr(effort, part)
        for number in range(rounds if part in parts else 0):
            for name, groups in ((f"{part}_{variant}", groups) for variant, groups in variants):
                jobs.append((name, partial(function, chains, name, groups, number, seconds)))
    return jobs


class Outcome(NamedTuple):
    """All that was measured, and what could not be."""

    samples: dict[str, list[Pair]]
    errors: list[str]
    interrupted: bool


def run(jobs: list[Job]) -> Outcome:
    """Run the jobs with a progress bar; a job that fails is noted and the rest goes on."""
    samples: dict[str, list[Pair]] = {}
    errors: list[str] = []
    try:
        for name, job in (bar := tqdm(jobs, unit="round", dynamic_ncols=True, disable=None)):
            bar.set_description(name)
            try:
                pairs = job()
            except BenchError as error:
                errors.append(f"{name}: {error}")
                continue
            for key, pair in pairs.items():
                samples.setdefault(key, []).append(pair)
    except KeyboardInterrupt:
        return Outcome(samples, errors, True)
    return Outcome(samples, errors, False)


def machine() -> dict[str, str]:
    """Say what it was measured on."""
    lines = Path("/proc/cpuinfo").read_text().splitlines() if Path("/proc/cpuinfo").exists() else []
    names = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    return {
        "cpu": f"{len(os.sched_getaffinity(0))} x {names[0] if names else platform.machine()}",
        "python": platform.python_version(),
        "date": time.strftime("%Y-%m-%d"),
        "load": f"{os.getloadavg()[0]:.1f}",
    }


def write_outcome(path: Path, outcome: Outcome, rows: list[Row], where: dict[str, str]) -> None:
    """Write rows, the rounds they come from, and the errors."""
    content = {
        "machine": where,
        "complete": not outcome.interrupted and not outcome.errors,
        "errors": outcome.errors,
        "rows": [row.as_dict() for row in rows],
        "samples": outcome.samples,
    }
    path.parent.mkdir(parents=True, exist_ok=True)
    write_json(path, content)


def write_docs(rows: list[Row], where: dict[str, str]) -> None:
    """Put the table between the markers of docs/results/performance/index.md."""
    before, rest = DOCS.read_text(encoding="utf-8").split(BEGIN)
    _, after = rest.split(END)
    conditions = (
        f"{where['date']}, {where['cpu']}, Python {where['python']}, load average {where['load']} at the start."
    )
    write_text(DOCS, f"{before}{BEGIN}\n{conditions}\n\n{markdown_table(rows)}\n{END}{after}")


def parse(arguments: list[str] | None) -> argparse.Namespace:
    """Read the command line."""
    parser = argparse.ArgumentParser(description="Speed of diffbot beside bare rclpy relays and bare filterpy.")
    parser.add_argument("--quick", action="store_true", help="one short round of each: half a minute, rough")
    parser.add_argument("--only", choices=PARTS, action="append", help="measure this part only (may be repeated)")
    parser.add_argument("--strict", action="store_true", help="exit status 2 if a target is missed")
    parser.add_argument("--out", type=Path, default=ROOT / "out" / "bench.json", help="default: %(default)s")
    parser.add_argument("--write-docs", action="store_true", help="put the table into docs/results/performance")
    options = parser.parse_args(arguments)
    if options.write_docs and (options.quick or options.only):
        parser.error("--write-docs wants the whole benchmark: no --quick, no --only")
    return options


def status(outcome: Outcome, rows: list[Row], strict: bool) -> int:
    """Return 130 after Ctrl-C, 1 if something could not be measured, 2 for a missed target with --strict."""
    if outcome.interrupted:
        return 130
    if outcome.errors:
        return 1
    return 2 if strict and any(row.met is False for row in rows) else 0


def main(arguments: list[str] | None = None) -> int:
    """Run the benchmark; print the table; the exit status."""
    options = parse(arguments)
    where = machine()
    wait = "half a minute" if options.quick else "four minutes"
    print(f"{where['cpu']}, Python {where['python']}, load average {where['load']}; takes up to {wait}", flush=True)
    domain = PrivateDomain()
    try:
        with tempfile.TemporaryDirectory(prefix="diffbot-bench-") as folder:
            chains = Chains(domain.id, Path(folder))
            outcome = run(plan(chains, QUICK if options.quick else FULL, options.only or list(PARTS)))
    finally:
        domain.release()
    rows = make_rows(outcome.samples)
    print(text_table(rows))
    for error in outcome.errors:
        print(f"NOT MEASURED: {error}", file=sys.stderr)
    write_outcome(options.out, outcome, rows, where)
    print(f"Written: {options.out}")
    result = status(outcome, rows, options.strict)
    if options.write_docs and result in (0, 2):
        write_docs(rows, where)
        print(f"Written: {DOCS}")
    return result


if __name__ == "__main__":
    raise SystemExit(main())
