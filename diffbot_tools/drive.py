"""The commands ``diffbot goal``, ``dock`` and ``undock``: send a goal, show the progress, report the result."""

from __future__ import annotations

import argparse
import contextlib
import importlib
import math
import os
import re
import signal
import sys
import time
from pathlib import Path
from typing import Any, NamedTuple

from tqdm import tqdm

from diffbot_control.goals import record as goal_record
from diffbot_control.law.docking_axis import pose_on_axis
from diffbot_core.errors import DiffbotError, InvalidValueError
from diffbot_core.geometry import MAX_COORDINATE, Pose, out_of_frame
from diffbot_tools.arguments import angle, duration, number_between

ENDS = {
    goal_record.REACHED: 0,
    goal_record.NOT_REACHED: 3,
    goal_record.REPLACED: 4,
    goal_record.CANCELLED: 5,
    goal_record.POSE_LOST: 6,
    goal_record.REFUSED: 1,
    "lost": 7,
}
"""Exit status for each end of a goal. 1 is also the status of any other error, 2 of wrong usage."""
TIMED_OUT, INTERRUPTED = 8, 130
DISCOVERY_TIMEOUT = 120.0
"""[s] longest time to wait for a controller, which may still be starting on a slow computer"""
_REPORT_PERIOD = 3.0
"""[s] time without a controller after which the command reports that it is waiting"""
MAX_DOMAIN = 232
"""largest ROS_DOMAIN_ID"""
_CANCEL_TIMEOUT, _LAST_TIMEOUT = 5.0, 1.0
"""[s] longest time for a cancellation, and for the cancellation of a goal that the controller has not accepted"""
_DOCKING = "dock_controller"
"""default name of the controller that docks, which does not receive goals in the map"""
_PARAMETER_TIMEOUT = 3.0
"""[s] longest time to wait for a parameter of the docking controller, which need not run yet"""
_DISTANCE = 0.7
"""[m] distance of the staging pose from the docked pose, the default of the docking law"""
_NEGATIVE = re.compile(r"-(\d+|\d*\.\d+)(deg)?")
_POSITION = number_between(-MAX_COORDINATE, MAX_COORDINATE)


class GoalOptions(NamedTuple):
    """A goal, and the controller that receives it."""

    pose: Pose
    frame: str = "map"
    namespace: str = ""
    controller: str = "controller"
    timeout: float = math.inf
    """[s] time from the acceptance until the goal is cancelled"""
    restart_timeout: float = goal_record.RESTART_TIMEOUT
    """[s] grace period before a controller that has disappeared counts as gone"""
    wait: bool = True
    """wait for the end of the goal"""
    prefix: str = ""
    """prefix of the topic goal_pose"""
    signals: list[int] | None = None
    """list to which signals are appended; the goals of a command share it, so that no signal is lost between them"""


def add_drive(commands: Any) -> None:
    """Add ``diffbot goal``, ``dock`` and ``undock`` to the subparsers of the command line."""
    for command in (_add_goal(commands), *_add_docking(commands)):
        # Without this, argparse parses -90deg as a flag.
        command._negative_number_matcher = _NEGATIVE
        command.add_argument(
            "--timeout", type=duration, default=math.inf, metavar="S", help="cancel S seconds after the acceptance"
        )
        command.add_argument("--namespace", default="", metavar="NS", help="namespace of the robot")


def _add_goal(commands: Any) -> argparse.ArgumentParser:
    goal: argparse.ArgumentParser = commands.add_parser(
        "goal",
        help="drive to a goal pose and report the result",
        epilog="exit status: 0 reached (or accepted, with --no-wait), 1 error or refused, 2 usage, 3 not reached, "
        "4 replaced by another goal, 5 cancelled by another client, 6 pose lost, 7 controller gone or restarted, "
        "8 timeout, 130 interrupted",
    )
    goal.add_argument("x", type=_POSITION, help="position [m]")
    goal.add_argument("y", type=_POSITION, help="position [m]")
    goal.add_argument("yaw", type=angle, help="heading [rad], or in degrees as 90deg")
    goal.add_argument("--frame", default="map", help="frame of the goal (default: %(default)s)")
    goal.add_argument(
        "--wait", action=argparse.BooleanOptionalAction, default=True, help="wait for the end of the goal"
    )
    goal.add_argument(
        "--controller", default="controller", metavar="NAME", help="node that drives (default: %(default)s)"
    )
    goal.add_argument(
        "--restart-timeout",
        type=duration,
        default=goal_record.RESTART_TIMEOUT,
        metavar="S",
        help="grace period before a controller that has disappeared counts as gone [s] (default: %(default)g)",
    )
    goal.set_defaults(call=_goal)
    return goal


def _add_docking(commands: Any) -> tuple[argparse.ArgumentParser, argparse.ArgumentParser]:
    epilog = "The exit status is the same as for diffbot goal."
    dock = commands.add_parser("dock", help="drive into a detected dock and report the result", epilog=epilog)
    dock.add_argument(
        "pose",
        nargs="*",
        metavar="X Y YAW",
        help="pose of the docked robot in the map [m, m, rad]; if given, drive to the staging pose first",
    )
    dock.add_argument("--frame", default="map", help="frame of this pose (default: %(default)s)")
    dock.add_argument("--controller", default="controller", metavar="NAME", help="node that drives to the staging pose")
    dock.set_defaults(call=_dock)
    undock = commands.add_parser("undock", help="drive out of the dock along its axis", epilog=epilog)
    undock.set_defaults(call=_undock)
    for command in (dock, undock):
        command.add_argument(
            "--distance",
            type=number_between(0.05, 100.0),
            default=_DISTANCE,
            metavar="M",
            help="distance of the staging pose from the dock [m] (default: %(default)g)",
        )
        command.add_argument(
            "--backward", action="store_true", help="the robot docks backwards, as with the parameter dock_backward"
        )
        command.add_argument(
            "--docking-controller",
            default=_DOCKING,
            metavar="NAME",
            help="node that docks (default: %(default)s)",
        )
    return dock, undock


def _goal(options: argparse.Namespace) -> int:
    if options.controller == _DOCKING:
        # Another controller would receive the goal.
        sentence = "it only docks: use diffbot dock or diffbot undock"
        raise InvalidValueError("--controller", options.controller, sentence=sentence)
    given = {name: getattr(options, name) for name in GoalOptions._fields if hasattr(options, name)}
    return drive(GoalOptions(Pose(options.x, options.y, options.yaw), **given))


def _dock(options: argparse.Namespace) -> int:
    """Dock, after a drive to the staging pose if the pose of the dock is given; return the exit status."""
    signals = list[int]()
    if options.pose:
        words = " ".join(options.pose)
        try:
            types = zip((_POSITION, _POSITION, angle), options.pose, strict=True)
            pose = Pose(*(convert(text) for convert, text in types))
        except (ValueError, argparse.ArgumentTypeError) as error:
            reason = "must be three numbers, or none" if len(options.pose) != 3 else str(error)
            raise InvalidValueError("X Y YAW", words, sentence=reason) from None
        _check_direction(options)
        staging = out_of_frame(pose_on_axis(options.distance, options.backward), pose)
        names = options.frame, options.namespace, options.controller
        if status := drive(GoalOptions(staging, *names, timeout=options.timeout, signals=signals)):
            return status
    return _drive_in_dock_frame(options, Pose(0.0, 0.0, 0.0), signals)


def _check_direction(options: argparse.Namespace) -> None:
    """Refuse a flag that contradicts dock_backward: the staging pose would be on the far side of the dock.

    Raises:
        InvalidValueError: naming the docking controller.
    """
    name = options.docking_controller
    client = _client(options.namespace, name, frame="dock", prefix="dock/")
    try:
        backward = client.parameter("dock_backward", _PARAMETER_TIMEOUT)
    finally:
        client.close()
    if backward not in (None, options.backward):
        raise InvalidValueError("--backward", options.backward, f"{backward}, as the parameter dock_backward of {name}")


def _undock(options: argparse.Namespace) -> int:
    return _drive_in_dock_frame(options, pose_on_axis(options.distance, options.backward))


def _drive_in_dock_frame(options: argparse.Namespace, pose: Pose, signals: list[int] | None = None) -> int:
    names = "dock", options.namespace, options.docking_controller
    return drive(GoalOptions(pose, *names, timeout=options.timeout, prefix="dock/", signals=signals))


def drive(options: GoalOptions) -> int:
    """Drive to the goal; return the exit status.

    Raises:
        DiffbotError: if no controller is found, or the controller refuses the goal.
    """
    if not options.controller:
        raise InvalidValueError("--controller", options.controller, "the name of a node")
    # A signal must not end the process before the goal is cancelled, nor interrupt a call of ROS.
    signals: list[int] = [] if options.signals is None else options.signals
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda received, _frame: signals.append(received))
    names = {name: getattr(options, name) for name in ("namespace", "controller", "frame", "restart_timeout", "prefix")}
    client = _client(**names)
    client.is_stopped = lambda: bool(signals)
    try:
        _send(client, options)
        if options.wait:
            return _follow(client, options)
        print(f"goal {client.task.id} accepted")
        return 0
    except DiffbotError:
        if signals:
            return _cancel(client, "interrupted", INTERRUPTED)
        if client.task.is_sent:
            client.cancel(_LAST_TIMEOUT)
        raise
    finally:
        client.close()


def _client(namespace: str, controller: str, **options: Any) -> Any:
    """Return a goal client.

    Raises:
        DiffbotError: if a name is not allowed.
    """
    # Imported by name, since the command line must start without ROS.
    client_type = importlib.import_module("diffbot_control.ros.goals.client").GoalClient
    try:
        return client_type.in_own_context(namespace=namespace, controller=controller, **options)
    except Exception as error:  # rclpy raises several types for invalid names
        reason = " ".join(str(error).split())
        raise DiffbotError(f"namespace {namespace!r}, controller {controller!r}: {reason}") from None


def _send(client: Any, options: GoalOptions) -> None:
    """Wait for the controller, send the goal, and wait until it is accepted."""
    deadline = time.monotonic() + min(options.timeout, DISCOVERY_TIMEOUT)
    shown: set[str] = set()
    while (left := deadline - time.monotonic()) > 0.0 and not client.wait_until_ready(min(_REPORT_PERIOD, left)):
        if client.is_stopped():
            break
        for line in _waiting_lines(client.seen_controllers(), options):
            if line not in shown:
                print(line, file=sys.stderr, flush=True)
            shown.add(line)
    client.send_goal([options.pose], timeout=max(deadline - time.monotonic(), 0.0))


def _waiting_lines(controllers: list[str], options: GoalOptions) -> list[str]:
    """Return lines for the user about the awaited controller, other controllers and other domains."""
    own = os.environ.get("ROS_DOMAIN_ID") or "0"
    awaited = "/" + f"{options.namespace.strip('/')}/{options.controller}".lstrip("/")
    lines = [f"waiting for the controller {awaited} on ROS_DOMAIN_ID {own} ..."]
    if not controllers:
        lines.append("  no controller runs in this domain; to simulate a robot: diffbot run robot --with plant")
    for name in controllers:
        namespace, _, node = name.rpartition("/")
        flags = f" --namespace {namespace.strip('/')}" * bool(namespace)
        flags += f" --controller {node}" * (node not in ("controller", _DOCKING))
        lines.append(f"  {name} is running: diffbot {'dock' if node == _DOCKING else 'goal X Y YAW'}{flags}")
    with contextlib.suppress(OSError):  # not Linux
        others = [one for one in used_domains(Path("/proc/net/udp").read_text()) if str(one) != own]
        if others:
            lines.append(f"  other values of ROS_DOMAIN_ID in use on this machine: {', '.join(map(str, others))}")
    return lines


def used_domains(table: str) -> list[int]:
    """Return the ROS domains whose discovery ports are open (DDSI-RTPS 9.6.1); ``table`` is /proc/net/udp."""
    ports = {int(line.split()[1].rpartition(":")[2], 16) for line in table.splitlines()[1:]}
    return [domain for domain in range(MAX_DOMAIN + 1) if ports & {7400 + 250 * domain, 7410 + 250 * domain}]


def _follow(client: Any, options: GoalOptions) -> int:
    """Show the progress until the goal ends, the timeout or a signal; return the exit status."""
    deadline, reported = time.monotonic() + options.timeout, set[str]()
    bar_format = "{l_bar}{bar}| {n:.2f}/{total:.2f} m{postfix}"
    with tqdm(total=0.0, bar_format=bar_format, leave=False, disable=None, file=sys.stderr) as bar:
        while not client.wait_for_end(min(0.2, max(deadline - time.monotonic(), 0.0))):
            if client.task.feedback is not None:
                distance = client.task.feedback.distance_remaining
                bar.total = max(bar.total, distance)
                bar.n = bar.total - distance
                bar.set_postfix_str(f"about {client.task.feedback.estimated_time_remaining.sec} s left")
            if client.problem and client.problem not in reported:
                bar.write(client.problem, file=sys.stderr)
                reported.add(client.problem)
            if client.is_stopped() or time.monotonic() >= deadline:
                break
    task = client.task
    if task.end:
        after = "" if math.isnan(task.elapsed) else f", {task.elapsed:.1f} s after its acceptance"
        print(f"{task.text}{after}")
        return ENDS[task.end]
    if client.is_stopped():
        return _cancel(client, "interrupted", INTERRUPTED)
    return _cancel(client, f"not reached within --timeout {options.timeout:g} s", TIMED_OUT)


def _cancel(client: Any, why: str, status: int) -> int:
    client.is_stopped = lambda: False
    if not client.task.is_sent:
        ending = "no goal was sent"
    elif client.cancel(_CANCEL_TIMEOUT):
        ending = "goal cancelled" if client.task.end == goal_record.CANCELLED else f"the goal ended: {client.task.text}"
    else:
        ending = "the controller did not confirm the cancellation"
    print(f"{why}: {ending}")
    return status
