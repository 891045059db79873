"""The command ``diffbot goal``: sends a goal, shows a progress bar, and reports its end in one line."""

from __future__ import annotations

import argparse
import contextlib
import importlib
import math
import os
import signal
import sys
import time
from pathlib import Path
from typing import Any, NamedTuple

from tqdm import tqdm

from diffbot_control.goals import goal_record
from diffbot_core.errors import DiffbotError, InvalidValueError
from diffbot_core.geometry import MAX_COORDINATE, Pose
from diffbot_core.ranges import HEADING
from diffbot_tools.arguments import duration, number_between

ENDS = {
    goal_record.REACHED: 0,
    goal_record.NOT_REACHED: 3,
    goal_record.REPLACED: 4,
    goal_record.CANCELLED: 5,
    goal_record.POSE_LOST: 6,
    "lost": 7,
}
"""Exit status of each end; 1 is an error such as a refused goal, 2 wrong usage."""
TIMED_OUT, INTERRUPTED = 8, 130
DISCOVERY_TIMEOUT = 120.0
"""[s] within which the controller has to answer: it may just be starting, on a small or busy computer"""
_PATIENCE = 3.0
"""[s] without a controller after which the command reports that it waits for one"""
_MAX_DOMAIN = 232
_CANCEL_TIMEOUT, _LAST_TIMEOUT = 5.0, 1.0
"""[s] for a cancellation, and for one of a goal that was never answered"""


class GoalOptions(NamedTuple):
    """Options of the command line."""

    pose: Pose
    frame: str
    wait: bool
    timeout: float
    """[s]; inf: none"""
    namespace: str
    controller: str
    restart_timeout: float
    """[s] for which the controller may be away"""


def add_goal(commands: Any) -> None:
    """Add ``diffbot goal`` to the subparsers of the command line."""
    goal = commands.add_parser(
        "goal",
        help="drive to a goal pose and report how it ended",
        epilog="exit status: 0 reached (or accepted, with --no-wait), 1 error or refused, 2 usage, 3 not reached, "
        "4 replaced by another goal, 5 cancelled by others, 6 pose lost, 7 controller gone or restarted, 8 timeout, "
        "130 interrupted",
    )
    goal.add_argument("x", type=number_between(-MAX_COORDINATE, MAX_COORDINATE), help="position [m]")
    goal.add_argument("y", type=number_between(-MAX_COORDINATE, MAX_COORDINATE), help="position [m]")
    goal.add_argument("yaw", type=number_between(*HEADING), help="heading [rad]")
    goal.add_argument("--frame", default="map", help="frame of the goal (default: %(default)s)")
    goal.add_argument(
        "--wait", action=argparse.BooleanOptionalAction, default=True, help="wait for the end (default: --wait)"
    )
    goal.add_argument("--timeout", type=duration, default=math.inf, metavar="S", help="cancel after this time [s]")
    goal.add_argument("--namespace", default="", metavar="NS", help="namespace of the robot")
    goal.add_argument("--controller", default="controller", metavar="NAME", help="its node (default: %(default)s)")
    goal.add_argument(
        "--restart-timeout",
        type=duration,
        default=goal_record.RESTART_TIMEOUT,
        metavar="S",
        help="time without a sign of life after which a controller counts as gone [s] (default: %(default)g)",
    )
    goal.set_defaults(call=_call)


def _call(options: argparse.Namespace) -> int:
    pose = Pose(options.x, options.y, options.yaw)
    names = options.namespace, options.controller
    return run(GoalOptions(pose, options.frame, options.wait, options.timeout, *names, options.restart_timeout))


def run(options: GoalOptions) -> int:
    """Drive to the goal; return the exit status.

    Raises:
        DiffbotError: in one line, if no controller is found or it refuses the goal.
    """
    if not options.controller:
        raise InvalidValueError("--controller", options.controller, "the name of a node")
    # ROS is not imported by the command line: it starts without it.
    client_type = importlib.import_module("diffbot_control.ros.goals.client").GoalClient
    stop = _Stop()
    began = time.monotonic()
    try:
        client = client_type.in_own_context(
            namespace=options.namespace,
            controller=options.controller,
            frame=options.frame,
            restart_timeout=options.restart_timeout,
        )
    except Exception as error:  # rclpy raises several types for names that no node can have
        raise DiffbotError(
            f"namespace {options.namespace!r}, controller {options.controller!r}: {_one_line(error)}"
        ) from None
    try:
        client.is_stopped = lambda: stop.is_set
        try:
            _send(client, options, began)
        except DiffbotError:
            if stop.is_set:
                return _cancel(client, "interrupted", INTERRUPTED)
            if client.task.is_sent:
                client.cancel(_LAST_TIMEOUT)
            raise
        if not options.wait:
            print(f"goal {client.task.id} accepted")
            return 0
        return _follow(client, options, began, stop)
    finally:
        client.close()


def _send(client: Any, options: GoalOptions, began: float) -> None:
    deadline = began + min(options.timeout, DISCOVERY_TIMEOUT)
    said: list[str] = []
    while (left := deadline - time.monotonic()) > 0.0 and not client.wait_until_ready(min(_PATIENCE, left)):
        if client.is_stopped():
            break
        # Discovery may take longer than the first look.
        new = [line for line in _what_is_seen(client.seen_controllers(), options) if line not in said]
        for line in new:
            print(line, file=sys.stderr, flush=True)
        said += new
    client.send_goal([options.pose], timeout=max(deadline - time.monotonic(), 0.0))


def _what_is_seen(controllers: list[str], options: GoalOptions) -> list[str]:
    """Say which controllers answer instead of the one that is waited for, and how to reach them."""
    own = os.environ.get("ROS_DOMAIN_ID") or "0"
    wanted = "/" + f"{options.namespace.strip('/')}/{options.controller}".lstrip("/")
    lines = [f"waiting for the controller {wanted} on ROS_DOMAIN_ID {own} ..."]
    for name in controllers:
        namespace, _, node = name.rpartition("/")
        flags = f" --namespace {namespace.strip('/')}" * bool(namespace) + f" --controller {node}" * (
            node != "controller"
        )
        lines.append(f"  there is {name}: diffbot goal X Y YAW{flags}")
    with contextlib.suppress(OSError):  # not Linux
        others = [one for one in used_domains(Path("/proc/net/udp").read_text()) if str(one) != own]
        if others:
            lines.append(f"  other domains in use on this machine, for ROS_DOMAIN_ID: {', '.join(map(str, others))}")
    return lines


def used_domains(table: str) -> list[int]:
    """Return the ROS domains of which a process has a discovery port (DDSI-RTPS 9.6.1), from /proc/net/udp."""
    ports = {int(line.split()[1].rpartition(":")[2], 16) for line in table.splitlines()[1:]}
    return [domain for domain in range(_MAX_DOMAIN + 1) if ports & {7400 + 250 * domain, 7410 + 250 * domain}]


class _Stop:
    """Set by SIGINT and SIGTERM: a signal must not break a call of ROS, since the goal is still to be cancelled."""

    def __init__(self) -> None:
        self.is_set = False
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, self._on_signal)

    def _on_signal(self, _number: int, _frame: object) -> None:
        self.is_set = True


def _follow(client: Any, options: GoalOptions, began: float, stop: _Stop) -> int:
    deadline = began + options.timeout
    with _bar() as bar:
        while not client.wait_for_end(min(0.2, max(deadline - time.monotonic(), 0.0))):
            _show(bar, client.task.feedback)
            if stop.is_set:
                break
            if time.monotonic() >= deadline:
                break
    task, elapsed = client.task, time.monotonic() - began
    if task.end:
        print(f"{_words(task)}, {elapsed:.1f} s")
        return ENDS[task.end]
    if stop.is_set:
        return _cancel(client, "interrupted", INTERRUPTED)
    return _cancel(client, f"not reached within --timeout {options.timeout:g} s", TIMED_OUT)


def _cancel(client: Any, why: str, status: int) -> int:
    client.is_stopped = lambda: False
    if not client.task.is_sent:
        ending = "no goal was sent"
    elif client.cancel(_CANCEL_TIMEOUT):
        ending = (
            "goal cancelled" if client.task.end == goal_record.CANCELLED else f"the goal ended: {_words(client.task)}"
        )
    else:
        ending = "the controller did not confirm the cancellation"
    print(f"{why}: {ending}")
    return status


def _words(task: Any) -> str:
    return f"{task.end}: {task.reason}" if task.reason else str(task.end)


def _bar() -> Any:
    form = "{l_bar}{bar}| {n:.2f}/{total:.2f} m{postfix}"
    return tqdm(total=0.0, bar_format=form, leave=False, disable=None, file=sys.stderr)


def _show(bar: Any, feedback: Any) -> None:
    if feedback is None:
        return
    distance = feedback.distance_remaining
    bar.total = max(bar.total, distance)
    bar.n = bar.total - distance
    bar.set_postfix_str(f"about {feedback.estimated_time_remaining.sec} s left")


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split())
