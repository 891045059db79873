"""Run nodes in one process until a signal arrives or a node ends, and shut them down in bounded time."""

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
from diffbot_core.yaml_files import ParameterFiles

SPIN_TIMEOUT = 0.05
"""[s] Longest time between two checks of the signal flag."""
READERS_TIMEOUT = 1.5
"""[s] Longest time to wait at the end until reliable readers have received all messages."""
END_TIMEOUT = 4
"""[s] Longest time to destroy all nodes; ros2 launch sends a second signal 5 s after the first one."""
_CLOCK_MONOTONIC, _SIGEV_THREAD = 1, 2
"""Constants of <time.h> and <signal.h> on Linux."""


def make_executor(context: rclpy.Context | None = None) -> Executor:
    """Return an EventsExecutor of rclpy, or a SingleThreadedExecutor if rclpy does not have it.

    The EventsExecutor needs about a third of the CPU time. Call its ``spin_once(timeout_sec=...)``, because its
    ``spin()`` runs no callback in rclpy 7.1.6. ``DIFFBOT_EXECUTOR=single`` selects the SingleThreadedExecutor.
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
    """Flag that SIGINT and SIGTERM set; further signals do not interrupt the shutdown.

    The handlers of rclpy would shut the context down at once, before a stop command is sent or a bag is closed.
    """

    def __init__(self) -> None:
        """Install the signal handlers."""
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
    """Run nodes on one executor until a signal arrives or a node ends; return the exit status of the process.

    Args:
        make_nodes: returns a node, or yields several nodes. The executor starts after all nodes have been created. At
            the end, the nodes that move the robot are shut down first, then the other nodes in their order.
        args: arguments as for rclpy.init.
        shared_memory: False makes Fast DDS use only UDP, unless an environment variable selects the transports. With
            shared memory, the death of another process can block publishing for a second.

    Returns:
        The largest status of :meth:`DiffbotNode.finish`; 0 after a signal; 1 if the nodes cannot start, with one line
        on stderr.
    """
    if not shared_memory:
        os.environ.setdefault("FASTDDS_BUILTIN_TRANSPORTS", "UDPv4")
    words = sys.argv[1:] if args is None else args
    try:
        DiffbotNode.files = files = ParameterFiles(words[words.index("--ros-args") :] if "--ros-args" in words else ())
        stop = StopFlag()
        _init(args)
    except DiffbotError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    nodes: list[DiffbotNode[Any]] = []
    executor: Executor | None = None
    failed = True
    try:
        _create(make_nodes, nodes, files)
        files.check_all_used()
        _check_parameters_used(nodes, words, files)
        executor = _spin(nodes, stop)
        failed = False
    except DiffbotError as error:
        print(f"error: {' '.join(str(error).split())}", file=sys.stderr)
    finally:
        DiffbotNode.files = None
        _shut_down(nodes, stop, failed)
        # Not earlier: ManagedNode.before_shutdown() needs the executor, and nodes keep a weak reference only. If the
        # executor has the last handle of a node, its end destroys the participant.
        with forced_exit(END_TIMEOUT, _status(nodes, failed)):
            del executor
    return _status(nodes, failed)


def _create(make_nodes: Factory, nodes: list[DiffbotNode[Any]], files: ParameterFiles) -> None:
    """Create the nodes and append each one to ``nodes``, so that they are destroyed if a later node fails.

    Raises:
        DiffbotError: with the name of the node, and with the file of a value that is not allowed.
    """
    try:
        made = make_nodes()
        for node in [made] if isinstance(made, DiffbotNode) else made:
            nodes.append(node)
    except (DiffbotError, ParameterException, InvalidParameterTypeException) as error:
        raise DiffbotError(files.error_text(error)) from error


def _check_parameters_used(nodes: list[DiffbotNode[Any]], words: list[str], files: ParameterFiles) -> None:
    """Raise DiffbotError if no node uses a given parameter; ROS would ignore the parameter silently."""
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
                raise DiffbotError(files.error_text(InvalidValueError(name, value, known_name(name, names)), full_name))


def _init(args: list[str] | None) -> None:
    try:
        # rcl would log invalid arguments in addition to the exception.
        set_logger_level("rcl", LoggingSeverity.FATAL)
        rclpy.init(args=args, signal_handler_options=SignalHandlerOptions.NO)
    except Exception as error:  # rclpy raises many types here, all because of invalid arguments
        raise DiffbotError(f"invalid arguments: {' '.join(str(error).split())}") from error
    if get_logger_effective_level("rcl") == LoggingSeverity.FATAL:  # unless --log-level rcl:=... was given
        set_logger_level("rcl", LoggingSeverity.UNSET)


def _status(nodes: list[DiffbotNode[Any]], failed: bool) -> int:
    """Return the exit status. before_shutdown() may change it, for example if the disk is full."""
    return max(int(failed), *(node.exit_code or 0 for node in nodes), 0)


def _shut_down(nodes: list[DiffbotNode[Any]], stop: StopFlag, failed: bool) -> None:
    # An ExitStack runs its callbacks in reverse order, and runs all of them even if one raises an exception.
    with ExitStack() as stack:
        # Python restores the default handlers at its exit; then a second signal would change the exit status.
        stack.callback(stop.ignore)
        stack.callback(_destroy, nodes, failed)
        for node in sorted(reversed(nodes), key=lambda node: node.moves_the_robot):
            stack.callback(node.before_shutdown)


def _destroy(nodes: list[DiffbotNode[Any]], failed: bool) -> None:
    with forced_exit(END_TIMEOUT, _status(nodes, failed)), ExitStack() as stack:
        stack.callback(rclpy.try_shutdown)
        for node in nodes:
            stack.callback(node.destroy_node)
        stack.callback(await_readers, nodes)


def _spin(nodes: list[DiffbotNode[Any]], stop: StopFlag) -> Executor:
    """Spin until the signal flag is set or a node ends; return the executor."""
    executor = _executor_of(nodes)
    for node in nodes:
        node.get_logger().info("ready")
    while not stop.is_set and all(node.exit_code is None for node in nodes):
        try:
            executor.spin_once(timeout_sec=SPIN_TIMEOUT)
        except ExternalShutdownException:
            raise
        except Exception as error:  # raised by the executor itself, not by a callback
            for node in nodes:
                node.contain(error, "the executor")
            executor.shutdown()
            # After an exception, an EventsExecutor calls no more callbacks.
            executor = _executor_of(nodes)
    return executor


def _executor_of(nodes: list[DiffbotNode[Any]]) -> Executor:
    executor = make_executor()
    for node in nodes:
        executor.add_node(node)
    return executor


def await_readers(nodes: Iterable[Node]) -> None:
    """Wait until all reliable readers have received all messages of the nodes, but at most READERS_TIMEOUT.

    Messages that a reader has not received are lost when the publisher is destroyed.
    """
    deadline = time.monotonic() + READERS_TIMEOUT
    for node in nodes:
        for publisher in node.publishers:
            publisher.wait_for_all_acked(Duration(seconds=max(0.0, deadline - time.monotonic())))


class _Expiry(ctypes.Structure):
    """``struct sigevent`` of a timer that calls ``function(value)`` in a thread of the C library."""

    _fields_ = (
        ("value", ctypes.c_void_p),
        ("signal", ctypes.c_int),
        ("notify", ctypes.c_int),
        ("function", ctypes.c_void_p),
        ("rest", ctypes.c_byte * 40),
    )


@contextmanager
def forced_exit(timeout: int, status: int) -> Iterator[None]:
    """End the process at once with ``status`` if the ``with`` block takes longer than ``timeout`` [s].

    Fast DDS 2.14 can deadlock while it destroys a participant (Fast-DDS #6513), mostly if several nodes end at the same
    time, as after Ctrl-C. rclpy holds the GIL meanwhile, so neither a thread nor a signal handler of Python could end
    the process. A timer of the C library can.
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
