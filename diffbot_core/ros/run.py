"""Run nodes in one process until a signal or one of them ends it, and shut them down in bounded time."""

from __future__ import annotations

import ctypes
import itertools
import os
import signal
import sys
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack, contextmanager
from typing import Any, TypeAlias

import rclpy
from rclpy.duration import Duration
from rclpy.exceptions import InvalidParameterTypeException, ParameterException
from rclpy.executors import Executor, ExternalShutdownException, SingleThreadedExecutor
from rclpy.logging import LoggingSeverity, get_logger_effective_level, set_logger_level
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

from diffbot_core.errors import DiffbotError, InvalidValueError, known_name
from diffbot_core.ros.node import DiffbotNode
from diffbot_core.ros.parameters import is_qos_override
from diffbot_core.yaml_files import GivenFiles

SPIN_TIMEOUT = 0.05
"""[s] maximum time between two checks of the signal flag"""
READERS_TIMEOUT = 1.5
"""[s] at the end, for reliable readers to receive what the nodes published"""
END_TIMEOUT = 4
"""[s] for the middleware to destroy all nodes; ros2 launch sends its next signal 5 s after the first one"""
_CLOCK_MONOTONIC, _SIGEV_THREAD = 1, 2
"""of <time.h> and <signal.h> of Linux"""


def make_executor(context: rclpy.Context | None = None) -> Executor:
    """Return the executor of all nodes: rclpy's EventsExecutor, or the SingleThreadedExecutor where it is missing.

    The EventsExecutor needs about a third of the CPU time. It must be driven by ``spin_once(timeout_sec=...)``: with
    its ``spin()``, no callback runs in rclpy 7.1.6. ``DIFFBOT_EXECUTOR=single`` selects the SingleThreadedExecutor.
    """
    if os.environ.get("DIFFBOT_EXECUTOR", "events") != "single":
        try:
            from rclpy.experimental.events_executor import EventsExecutor  # noqa: PLC0415 - not in every rclpy
        except ImportError:
            rclpy.logging.get_logger("diffbot").info("no EventsExecutor in this rclpy: using SingleThreadedExecutor")
        else:
            return EventsExecutor(context=context)
    return SingleThreadedExecutor(context=context)


class StopFlag:
    """Set by SIGINT and SIGTERM; further signals have no effect, so that the shutdown is not interrupted.

    rclpy's own handlers would shut the context down at once, before a stop command is sent or a bag is closed.
    """

    def __init__(self) -> None:
        """Install the handlers of this process."""
        self.is_set = False
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, self._on_signal)

    def _on_signal(self, _number: int, _frame: object) -> None:
        self.is_set = True

    def ignore(self) -> None:
        """Ignore both signals until the process exits."""
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, signal.SIG_IGN)


Factory: TypeAlias = "Callable[[], DiffbotNode[Any] | Iterator[DiffbotNode[Any]]]"


def run(make_nodes: Factory, args: list[str] | None = None, *, shared_memory: bool = True) -> int:
    """Run nodes on one executor until a signal, or until one of them ends; return the exit status of the process.

    Args:
        make_nodes: returns a node, or creates several nodes one after the other; none of them handles a message
            before all exist. At the end the nodes that move the robot are shut down first, then the others in their
            order.
        args: as of rclpy.init.
        shared_memory: False makes Fast DDS use UDP alone, unless the environment says otherwise. When a process dies,
            Fast DDS checks its shared memory in each other process, which can block publishing there for a second.

    Returns:
        The largest status of :meth:`DiffbotNode.finish`; 0 after a signal; 1, with one line on stderr, if the nodes
        cannot start.
    """
    if not shared_memory:
        os.environ.setdefault("FASTDDS_BUILTIN_TRANSPORTS", "UDPv4")
    words = sys.argv[1:] if args is None else args
    try:
        DiffbotNode.files = files = GivenFiles(words[words.index("--ros-args") :] if "--ros-args" in words else ())
        stop = StopFlag()
        _init(args)
    except DiffbotError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    nodes: list[DiffbotNode[Any]] = []
    failed = True
    try:
        _make(make_nodes, nodes, files)
        files.check_all_used()
        _check_parameters_used(nodes, words, files)
        _spin(nodes, stop)
        failed = False
    except DiffbotError as error:
        print(f"error: {' '.join(str(error).split())}", file=sys.stderr)
    finally:
        DiffbotNode.files = None
        _shut_down(nodes, stop, failed)
    return _status(nodes, failed)


def _make(make_nodes: Factory, nodes: list[DiffbotNode[Any]], files: GivenFiles) -> None:
    """Append the nodes one by one: the nodes made before a failure are destroyed, too.

    Raises:
        DiffbotError: naming the node, and the file of a refused value.
    """
    try:
        made = make_nodes()
        for node in [made] if isinstance(made, DiffbotNode) else made:
            nodes.append(node)
    except (DiffbotError, ParameterException, InvalidParameterTypeException) as error:
        raise DiffbotError(files.located(error)) from error


def _check_parameters_used(nodes: list[DiffbotNode[Any]], words: list[str], files: GivenFiles) -> None:
    """Refuse a given parameter that no node uses, which ROS ignores without a word.

    Raises:
        DiffbotError: naming the parameter and what to write instead.
    """
    names = {name for node in nodes for name in node.checked_parameters.names}
    for flag, word in itertools.pairwise(words):
        target, is_given, value = word.partition(":=")
        scope, _, name = target.rpartition(":")
        if flag not in ("-p", "--param") or not is_given or is_qos_override(name):
            continue
        addressed = [node for node in nodes if node.get_name() == scope] if scope else nodes
        if not addressed:
            here = ", ".join(node.get_name() for node in nodes)
            raise InvalidValueError("-p", word, sentence=f"no node {scope} runs in this process, only {here}")
        if not any(node.has_parameter(name) for node in addressed):
            owner = f"{scope} has no" if scope else "no node of this process has the"
            raise InvalidValueError("-p", word, sentence=f"{owner} parameter {name}: must be {known_name(name, names)}")
        if scope and addressed[0].get_namespace() != "/":
            instead = f"use a parameter file with /**/{scope}, or -p {name}:={value}"
            raise InvalidValueError("-p", word, sentence=f"ROS ignores it for a node in a namespace: {instead}")
    for node in nodes:
        for name, value in node.checked_parameters.unknown.items():
            if not any(one.has_parameter(name) for one in nodes):
                full_name = node.get_fully_qualified_name()
                raise DiffbotError(files.located(InvalidValueError(name, value, known_name(name, names)), full_name))


def _init(args: list[str] | None) -> None:
    try:
        # Invalid arguments are reported once, below.
        set_logger_level("rcl", LoggingSeverity.FATAL)
        rclpy.init(args=args, signal_handler_options=SignalHandlerOptions.NO)
    except Exception as error:  # rclpy raises many types here, all for invalid arguments
        raise DiffbotError(f"invalid arguments: {' '.join(str(error).split())}") from error
    if get_logger_effective_level("rcl") == LoggingSeverity.FATAL:  # unless --log-level rcl:=... was given
        set_logger_level("rcl", LoggingSeverity.UNSET)


def _status(nodes: list[DiffbotNode[Any]], failed: bool) -> int:
    """Return the exit status; before_shutdown may still change it, as a recorder's does on a full disk."""
    return max(int(failed), *(node.exit_code or 0 for node in nodes), 0)


def _shut_down(nodes: list[DiffbotNode[Any]], stop: StopFlag, failed: bool) -> None:
    with ExitStack() as last_first:
        # Python restores the default handlers when it exits; a second signal would then change the exit status.
        last_first.callback(stop.ignore)
        last_first.callback(_destroy, nodes, failed)
        for node in sorted(reversed(nodes), key=lambda node: node.moves_the_robot):
            last_first.callback(node.before_shutdown)


def _destroy(nodes: list[DiffbotNode[Any]], failed: bool) -> None:
    with forced_exit(END_TIMEOUT, _status(nodes, failed)), ExitStack() as last_first:
        last_first.callback(rclpy.try_shutdown)
        for node in nodes:
            last_first.callback(node.destroy_node)
        last_first.callback(await_readers, nodes)


def _spin(nodes: list[DiffbotNode[Any]], stop: StopFlag) -> None:
    """Spin until the signal flag is set or one of the nodes ends."""
    executor = _executor_of(nodes)
    for node in nodes:
        node.get_logger().info("ready")
    while not stop.is_set and all(node.exit_code is None for node in nodes):
        try:
            executor.spin_once(timeout_sec=SPIN_TIMEOUT)
        except ExternalShutdownException:
            raise
        except Exception as error:  # not of a callback: these are contained by their nodes
            for node in nodes:
                node.contain(error, "the executor")
            executor.shutdown()
            # After an exception an EventsExecutor calls nothing any more.
            executor = _executor_of(nodes)


def _executor_of(nodes: list[DiffbotNode[Any]]) -> Executor:
    executor = make_executor()
    for node in nodes:
        executor.add_node(node)
    return executor


def await_readers(nodes: Iterable[Node]) -> None:
    """Wait until all reliable readers have received what the nodes published, READERS_TIMEOUT in total at most.

    When a publisher is destroyed, its readers lose what they have not received yet.
    """
    deadline = time.monotonic() + READERS_TIMEOUT
    for node in nodes:
        for publisher in node.publishers:
            publisher.wait_for_all_acked(Duration(seconds=max(0.0, deadline - time.monotonic())))


class _Expiry(ctypes.Structure):
    """``struct sigevent``: ``function(value)`` is called in a thread of the C library."""

    _fields_ = (
        ("value", ctypes.c_void_p),
        ("signal", ctypes.c_int),
        ("notify", ctypes.c_int),
        ("function", ctypes.c_void_p),
        ("rest", ctypes.c_byte * 40),
    )


@contextmanager
def forced_exit(timeout: int, status: int) -> Iterator[None]:
    """End the process with ``status`` if the block takes longer than ``timeout`` [s], whatever it is doing then.

    Nothing more is flushed, closed or called. The Fast DDS 2.14 of the wheels can deadlock for ever while it destroys
    a participant (Fast-DDS #6513), mostly in nodes that end at the same moment, as with Ctrl-C. rclpy holds Python's
    lock meanwhile, so neither a thread nor a signal handler of Python could end the process; a timer of the C library
    can.
    """
    sys.stdout.flush()
    libc = ctypes.CDLL(None, use_errno=True)
    timer = ctypes.c_void_p()
    expiry = _Expiry(value=status, notify=_SIGEV_THREAD, function=ctypes.cast(libc._exit, ctypes.c_void_p))
    if libc.timer_create(_CLOCK_MONOTONIC, ctypes.byref(expiry), ctypes.byref(timer)):
        raise OSError(ctypes.get_errno(), "timer_create failed")
    try:
        once = (ctypes.c_long * 4)(0, 0, timeout, 0)  # struct itimerspec: period and delay, each in s and ns
        libc.timer_settime(timer, 0, once, None)
        yield
    finally:
        libc.timer_delete(timer)
