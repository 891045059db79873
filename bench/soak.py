"""Goals and faults for ten minutes: ``python bench/soak.py [--minutes M] [--seed N] [--json FILE]``.

A fault strikes during every other goal. Exit status 1, with one line for each promise that was broken.
"""

import argparse
import contextlib
import json
import random
import signal
import sys
import tempfile
import time
from pathlib import Path

from soak_graph import MAX_SLOPE, START, WARM_UP, Graph
from tqdm import tqdm

from diffbot_control.ros.goals.client import LOST, NoControllerError
from diffbot_control.ros.navigator import Navigator
from diffbot_core.files import write_json
from diffbot_core.geometry import Pose

GOAL_TIMEOUT = 120.0
KILLS = ("kill ekf", "kill controller", "kill plant")
HELD_UP = ("SIGSTOP ekf", "SIGSTOP plant", "SIGSTOP controller")
TRAFFIC = ("bad messages", "goal replaced", "goal cancelled")
NONE = "no fault"
RADIUS = 2.0
"""[m] about the start in which the goals are"""


class Soak:
    """Goals one after the other, from a seed."""

    def __init__(self, graph, seed, kills_until):
        """Start; nodes are killed until ``kills_until`` (monotonic)."""
        self._graph, self._random, self._kills_until = graph, random.Random(seed), kills_until
        self.goals = {one: {"sent": 0, "reached": 0} for one in (NONE, *KILLS, *HELD_UP, *TRAFFIC)}
        self._client = Navigator.in_own_context()
        self._number = 0

    def run_one(self):
        """Drive to one goal; every other time with a fault during the drive."""
        self._number += 1
        kinds = HELD_UP + TRAFFIC + (KILLS if time.monotonic() < self._kills_until else ())
        fault = NONE if self._number % 2 else self._random.choice(kinds)
        counts = self.goals[fault]
        counts["sent"] += 1
        goal = self._goal()
        self._send(goal)
        if fault != NONE:
            self._client.wait_for_end(self._random.uniform(0.3, 1.5))
            self._strike(fault, goal)
        counts["reached"] += self._reached(goal)

    def _goal(self):
        x, y = (self._random.uniform(-RADIUS, RADIUS) for _ in range(2))
        return Pose(START[0] + x, START[1] + y, self._random.uniform(-3.0, 3.0))

    def _send(self, goal):
        self._client.send_goal([goal], timeout=GOAL_TIMEOUT)

    def _strike(self, fault, goal):
        kind, _, name = fault.partition(" ")
        if kind == "kill":
            self._graph.restart(name)
        elif kind == "SIGSTOP":
            self._graph.hold_up(name, self._random.uniform(0.5, 3.0))
        elif fault == "bad messages":
            self._graph.send_bad_messages(self._client)
        else:
            if fault == "goal cancelled":
                self._client.cancel()
            self._send(self._goal())
            self._send(goal)

    def _reached(self, goal):
        self._client.wait_for_end(GOAL_TIMEOUT)
        if self._client.task.end == LOST:
            # A controller that was started again has no goal, and its client sends it once more.
            self._send(goal)
            self._client.wait_for_end(GOAL_TIMEOUT)
        if self._client.task.end != "reached":
            tqdm.write(f"goal {self._number}: {self._client.getReason() or 'no end'}", file=sys.stderr)
        return self._client.task.end == "reached"

    def close(self):
        """Leave the graph."""
        self._client.close()


def broken_promises(result):
    """Return one line for each promise that was broken."""
    lines = [
        f"{fault}: {count['reached']} of {count['sent']} goals reached"
        for fault, count in result["goals"].items()
        if count["reached"] < count["sent"]
    ]
    for name, one in result["nodes"].items():
        if one["slope"] > MAX_SLOPE:
            lines.append(f"{name}: RSS grows by {one['slope']:.3f} MB/min, allowed {MAX_SLOPE:g}")
        lines += [
            f"{name}: {kind} grew from {one[kind][0]} to {one[kind][1]}"
            for kind in ("threads", "descriptors")
            if one[kind][1] > one[kind][0]
        ]
    return lines + result["defects"]


def arguments():
    """Return the options of the command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--minutes", type=float, default=10.0, help="(default: %(default)g)")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--json", type=Path, help="file whose entry `soak` is written")
    options = parser.parse_args()
    if not 0.1 <= options.minutes <= 10_000:
        parser.error(f"--minutes {options.minutes:g}: must be >= 0.1 and <= 10000")
    return options


def run(options, folder):
    """Drive for the time asked for, or until Ctrl-C; return the result."""
    begin = time.monotonic()
    end = begin + 60.0 * options.minutes
    with Graph(folder) as graph:
        soak = Soak(graph, options.seed, begin + 20.0 * options.minutes)
        with tqdm(total=round(60 * options.minutes), unit="s") as bar, contextlib.suppress(KeyboardInterrupt):
            while time.monotonic() < end:
                try:
                    soak.run_one()
                except NoControllerError as error:
                    tqdm.write(str(error), file=sys.stderr)
                bar.update(min(round(time.monotonic() - begin), bar.total) - bar.n)
        soak.close()
        minutes = (time.monotonic() - begin) / 60.0
        nodes, defects = graph.finish()
    return {
        "minutes": minutes,
        "seed": options.seed,
        "warm_up": WARM_UP,
        "max_slope": MAX_SLOPE,
        "goals": {fault: count for fault, count in soak.goals.items() if count["sent"]},
        "nodes": nodes,
        "defects": defects,
    }


def main():
    options = arguments()
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    with tempfile.TemporaryDirectory() as folder:
        result = run(options, Path(folder))
    if options.json:
        content = json.loads(options.json.read_text()) if options.json.is_file() else {}
        write_json(options.json, content | {"soak": result})
    print(json.dumps(result, indent=1))
    lines = broken_promises(result)
    print("\n".join(lines), file=sys.stderr)
    return 1 if lines else 0


if __name__ == "__main__":
    sys.exit(main())
