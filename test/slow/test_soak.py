"""Goals for ten minutes, with a fault during every other goal: each is reached, and no process grows."""

import os
import random
import signal
import threading
import time
from pathlib import Path
from statistics import median_high

import pytest
from robot import robot
from scipy.stats import theilslopes

from diffbot_control.goals.record import SUSPENSION
from diffbot_control.ros.goals.client import LOST, NoControllerError
from diffbot_control.ros.navigator import Navigator
from diffbot_core.geometry import Pose

MINUTES = 10.0
WARM_UP, SAMPLE_PERIOD, MIN_SAMPLES = 60.0, 2.0, 20
"""[s] of a process before its first sample, [s] between samples, and number of samples that show a trend"""
MAX_SLOPE = 0.3
"""[MB/min] of a process's memory"""
GOAL_TIMEOUT, RADIUS = 120.0, 2.0
"""[s]; [m] largest coordinate of a goal"""
NODES = ("ekf", "controller", "plant")
KILLS = tuple(("kill", name) for name in NODES)
"""Only in the first third of the time, so that the new processes are sampled long enough."""
FAULTS = (*(("hold up", name) for name in NODES), ("replace", "goal"), ("cancel", "goal"))


class Sampler(threading.Thread):
    """Samples memory [MB], threads and open descriptors of each process after its warm-up."""

    def __init__(self, processes):
        super().__init__(daemon=True)
        self._processes, self._ended, self._begun = processes, threading.Event(), {}
        self.samples = {}

    def run(self):
        while not self._ended.wait(SAMPLE_PERIOD):
            for name, process in list(self._processes.items()):
                pid, now = process.popen.pid, time.monotonic()
                if now - self._begun.setdefault(pid, now) >= WARM_UP:
                    try:
                        status = Path(f"/proc/{pid}/status").read_text()
                        memory, threads = (int(status.partition(key)[2].split()[0]) for key in ("VmRSS:", "Threads:"))
                        found = now / 60.0, memory / 1024.0, threads, len(os.listdir(f"/proc/{pid}/fd"))
                    except (OSError, IndexError):  # the process has just been killed
                        continue
                    self.samples.setdefault((name, pid), []).append(found)

    def check(self):
        self._ended.set()
        self.join()
        long = {key: found for key, found in self.samples.items() if len(found) >= MIN_SAMPLES}
        assert {name for name, _ in long} == set(NODES)
        for key, found in long.items():
            times, memory, *counts = zip(*found, strict=True)
            slope = theilslopes(memory, times).slope
            print(f"{key}: {memory[-1]:.1f} MB, {slope:+.3f} MB/min in {times[-1] - times[0]:.1f} min")
            assert slope <= MAX_SLOPE, key
            for each in counts:
                assert median_high(each[len(each) // 2 :]) <= median_high(each[: len(each) // 2]), key


def strike(running, client, fault, rng):
    kind, name = fault
    if kind == "kill":
        running.processes[name].send(signal.SIGKILL)
        running.processes[name].wait()
        running.start(name)
    elif kind == "hold up":
        running.processes[name].send(signal.SIGSTOP)
        try:
            # After SUSPENSION, a controller ends its goal.
            time.sleep(rng.uniform(0.5, 0.8 * SUSPENSION if name == "controller" else 3.0))
        finally:
            running.processes[name].send(signal.SIGCONT)
    elif kind == "cancel":
        client.cancel()


def drive(running, client, fault, rng):
    """Drive to a random goal, with or without a fault; return the end of the goal."""

    def goal():
        return [Pose(*(rng.uniform(-RADIUS, RADIUS) for _ in range(2)), rng.uniform(-3.0, 3.0))]

    place = goal()
    client.send_goal(place, timeout=GOAL_TIMEOUT)
    if fault is not None:
        client.wait_for_end(rng.uniform(0.3, 1.5))
        strike(running, client, fault, rng)
        if fault[1] == "goal":
            client.send_goal(goal(), timeout=GOAL_TIMEOUT)
            client.send_goal(place, timeout=GOAL_TIMEOUT)
    client.wait_for_end(GOAL_TIMEOUT)
    if client.task.end == LOST:
        # A restarted controller does not have a goal: send it again.
        client.send_goal(place, timeout=GOAL_TIMEOUT)
        client.wait_for_end(GOAL_TIMEOUT)
    return client.task.end


@pytest.mark.slow
@pytest.mark.timeout(120.0 * MINUTES)
def test_goals_are_reached_whatever_happens_and_no_process_grows():
    rng, begin, ends, killed = random.Random(1), time.monotonic(), [], 0
    with robot() as running:
        sampler, client = Sampler(running.processes), Navigator.in_own_context()
        sampler.start()
        while (passed := (time.monotonic() - begin) / 60.0) < MINUTES:
            fault = None
            if len(ends) % 2:
                fault = rng.choice(FAULTS + KILLS if passed < MINUTES / 3.0 else FAULTS)
                killed += fault in KILLS
            try:
                ends.append((fault, drive(running, client, fault, rng)))
            except NoControllerError as error:
                ends.append((fault, str(error)))
            running.catch_up()
        client.close()
        sampler.check()
        print(f"{len(ends)} goals")
        assert [one for one in ends if one[1] != "reached"] == []
        assert all("Traceback" not in process.output for process in running.launched)
        assert [process.popen.poll() for process in running.launched].count(None) == len(NODES)
        assert len(running.launched) == len(NODES) + killed
