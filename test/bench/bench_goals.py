"""Is a goal ever lost? ``python test/bench/bench_goals.py [--goals N] [--launches N] [--seed N]``.

Goals by ``diffbot goal``, by a Navigator and by the action, with the recorder and two more subscribers on /goal_pose.
Right after each launch one goal of each way is sent while the graph is still starting; they replace each other. Then
the others follow, each after a random pause, from a client that is as new. A goal is *answered* if its client gets one
end; it is *lost* if not.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import random
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections import Counter
from pathlib import Path
from typing import Any

import rclpy
from action_msgs.msg import GoalStatus
from geometry_msgs.msg import PoseStamped
from rclpy.action import ActionClient
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from tqdm import tqdm

from diffbot_control.ros.goal_client import NoControllerError
from diffbot_control.ros.messages import goal_message
from diffbot_control.ros.navigator import Navigator
from diffbot_core.geometry import Pose
from diffbot_lab.campaign.statistics import wilson
from diffbot_lab.demo.processes import NodeProcesses, PrivateDomain
from diffbot_lab.goal_command import ENDS
from diffbot_lab.interfaces.build import build_interfaces

COMMAND, NAVIGATOR, ACTION = "diffbot goal", "Navigator", "action"
WAYS = (COMMAND, NAVIGATOR, ACTION)
START = Pose(0.0, 0.0, 0.0)
TIMEOUT = 120.0
"""[s] after which a goal without an end counts as lost"""
SIMULATED = {"use_sim_time": True}
_STATUSES = {GoalStatus.STATUS_SUCCEEDED: "reached", GoalStatus.STATUS_CANCELED: "cancelled"}


def near_goal(random_numbers: random.Random) -> Pose:
    """Return a goal a few steps from the others: what is measured is the answer, not the drive."""
    return Pose(*(random_numbers.uniform(-0.4, 0.4) for _ in range(3)))


def by_command(goal: Pose) -> str:
    """Send a goal with the command; return its end, empty if there was none."""
    command = [sys.executable, "-m", "diffbot_lab.cli", "goal", *map(str, goal), "--timeout", str(TIMEOUT)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    # A controller that takes longer to start than the command waits is an answer, and the user repeats it.
    if "no answer from" in done.stderr:
        return by_command(goal)
    ends = {status: end for end, status in ENDS.items()}
    return ends.get(done.returncode, "")


def by_navigator(goal: Pose) -> str:
    """Send a goal with a new Navigator; return its end."""
    navigator = Navigator.in_own_context()
    try:
        navigator.send_goal([goal], timeout=TIMEOUT)
        navigator.wait_for_end(TIMEOUT)
        return str(navigator.task.end)
    except NoControllerError:
        return ""
    finally:
        navigator.close()


def by_action(goal: Pose) -> str:
    """Send a goal with a new action client; return its end."""
    from nav2_msgs.action import NavigateToPose

    context = rclpy.Context()
    rclpy.init(context=context, signal_handler_options=SignalHandlerOptions.NO)
    node = Node("action_client", context=context)
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(node)
    client = ActionClient(node, NavigateToPose, "navigate_to_pose")

    def wait(condition: Any) -> bool:
        deadline = time.monotonic() + TIMEOUT
        while not condition() and time.monotonic() < deadline:
            executor.spin_once(timeout_sec=0.02)
        return bool(condition())

    try:
        if not wait(client.server_is_ready):
            return ""
        sent = client.send_goal_async(NavigateToPose.Goal(pose=goal_message(goal, "map", 0)))
        if not wait(sent.done) or not sent.result().accepted:
            return ""
        result = sent.result().get_result_async()
        if not wait(result.done):
            return ""
        status, message = result.result().status, result.result().result.error_msg
        return _STATUSES.get(status) or message.partition(":")[0]
    finally:
        executor.shutdown()
        client.destroy()
        node.destroy_node()
        context.try_shutdown()


SENDERS = {COMMAND: by_command, NAVIGATOR: by_navigator, ACTION: by_action}


class Campaign:
    """Counts ends by way and moment, and the goals lost."""

    def __init__(self, seed: int) -> None:
        """Start without goals."""
        self.ends = {way: Counter[str]() for way in WAYS}
        self._random = random.Random(seed)
        self._lock = threading.Lock()

    def send(self, way: str, goal: Pose, bar: Any) -> None:
        """Send one goal and count its end."""
        end = SENDERS[way](goal)
        with self._lock:
            self.ends[way][end or "lost"] += 1
            bar.update()
            bar.set_postfix_str(f"lost {sum(counter['lost'] for counter in self.ends.values())}")

    def launch(self, domain: int, counts: dict[str, int], bar: Any) -> None:
        """Start a graph, send ``counts`` goals of each way, stop the graph."""
        with tempfile.TemporaryDirectory() as folder, NodeProcesses(domain, Path(folder)) as processes:
            plant = {"clock": "scaled", "real_time_factor": 5.0, "seed": self._random.randrange(1000)}
            plant |= {f"initial_pose.{name}": value for name, value in zip(("x", "y", "yaw"), START, strict=True)}
            processes.start("recorder", "diffbot_bag.recorder_node", {"uri": str(Path(folder) / "bag")})
            processes.start("controller", "diffbot_control.controller_node", SIMULATED)
            processes.start("ekf", "diffbot_control.ekf_node", SIMULATED)
            processes.start("plant", "diffbot_sim.plant_node", plant)
            first = [way for way in WAYS if counts[way]]
            threads = [threading.Thread(target=self.send, args=(way, near_goal(self._random), bar)) for way in first]
            for thread in threads:
                thread.start()
            for thread in threads:
                thread.join()
            later = [way for way in first for _ in range(counts[way] - 1)]
            self._random.shuffle(later)
            for way in later:
                time.sleep(self._random.uniform(0.0, 0.5))
                self.send(way, near_goal(self._random), bar)

    def table(self) -> list[str]:
        """Return one line for each way, with the 95 % interval of the share that was answered."""
        lines = []
        for way, ends in self.ends.items():
            total = sum(ends.values())
            answered = total - ends["lost"]
            low, high = wilson(answered, total) if total else (0.0, 0.0)
            words = ", ".join(f"{count} {end}" for end, count in sorted(ends.items()) if count)
            lines.append(f"{way:14s} {answered} of {total} answered [{low:.3f}, {high:.3f}]: {words}")
        return lines


@contextlib.contextmanager
def two_subscribers() -> Any:
    """Have two more nodes with a subscription on goal_pose."""
    context = rclpy.Context()
    rclpy.init(context=context, signal_handler_options=SignalHandlerOptions.NO)
    nodes = [Node(f"listener_{number}", context=context) for number in range(2)]
    for node in nodes:
        node.create_subscription(PoseStamped, "goal_pose", lambda _: None, 10)
    yield
    for node in nodes:
        node.destroy_node()
    context.try_shutdown()


def main() -> int:
    """Run the campaign; return 1 if a goal was lost."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--goals", type=int, default=100, help="of each way (default: %(default)s)")
    parser.add_argument("--launches", type=int, default=10, help="of the graph (default: %(default)s)")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--interfaces", type=Path, help="folder of `diffbot interfaces build` (default: built anew)")
    options = parser.parse_args()
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    campaign, domain = Campaign(options.seed), PrivateDomain()
    launches = min(options.launches, options.goals)
    with tempfile.TemporaryDirectory() as folder, tqdm(total=3 * options.goals, unit="goal") as bar:
        _prepare(options.interfaces or build_interfaces(Path(folder)).parent, domain.id)
        with contextlib.suppress(KeyboardInterrupt), two_subscribers():
            for number in range(launches):
                count = options.goals // launches + (number < options.goals % launches)
                campaign.launch(domain.id, dict.fromkeys(WAYS, count), bar)
    print("\n".join(campaign.table()))
    return int(any(ends["lost"] for ends in campaign.ends.values()))


def _prepare(folder: Path, domain: int) -> None:
    """Put the actions onto the path, and this process and those that it starts onto the domain."""
    sys.path.append(str(folder))
    os.environ["PYTHONPATH"] = f"{folder}:{os.environ['PYTHONPATH']}" if os.environ.get("PYTHONPATH") else str(folder)
    os.environ |= {"ROS_DOMAIN_ID": str(domain), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}


if __name__ == "__main__":
    sys.exit(main())
