"""Base of all nodes: checked parameters, guarded subscriptions, health reports, executor, signals and exit status."""

from __future__ import annotations

import os
import signal
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack
from contextvars import ContextVar
from typing import Any, Generic

import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.clock import Clock, ClockType
from rclpy.exceptions import InvalidParameterTypeException, ParameterException
from rclpy.executors import Executor, ExternalShutdownException, SingleThreadedExecutor
from rclpy.logging import LoggingSeverity, get_logger_effective_level, set_logger_level
from rclpy.qos import QoSProfile
from rclpy.signals import SignalHandlerOptions

from diffbot_core.errors import BadMessageError, DiffbotError
from diffbot_core.health import DROP_MEMORY, Health
from diffbot_core.parameter_files import GivenFiles
from diffbot_core.ros.base_node import BaseNode
from diffbot_core.ros.clock_watch import ClockWatch
from diffbot_core.ros.delivery import await_readers
from diffbot_core.ros.fault_parameters import FaultConfig
from diffbot_core.ros.faults import FaultRecord, is_refusal, one_line
from diffbot_core.ros.forced_exit import forced_exit
from diffbot_core.ros.parameters import NodeParameters, overrides_of
from diffbot_core.ros.publisher_watch import PublisherWatch
from diffbot_core.ros.qos import LATCHED as LATCHED  # noqa: PLC0414 - re-exported, as is QUEUE
from diffbot_core.ros.qos import QUEUE as QUEUE  # noqa: PLC0414
from diffbot_core.schema import C

DIAGNOSTICS_PERIOD = 1.0
"""[s] between two /diagnostics messages of a node"""
SPIN_TIMEOUT = 0.05
"""[s] maximum time between two checks of the signal flag"""
END_TIMEOUT = 4
"""[s] for the middleware to destroy all nodes; ros2 launch sends its next signal 5 s after the first one"""


_files_of_process: ContextVar[GivenFiles | None] = ContextVar("parameter files of this process", default=None)
"""as rclpy's overrides, which come from them: of the process, not of a node"""


class DiffbotNode(BaseNode, Generic[C]):
    """A node with checked parameters (``config``), guarded subscriptions and a 1 Hz report on /diagnostics."""

    _checked_parameters: NodeParameters[C]
    is_configured = True
    """False while a managed node has only its parameters"""
    is_active = True
    """False while a managed node does not work"""
    moves_the_robot = False
    """True for a node that has to stop the robot before others end"""

    def __init__(
        self, name: str, config_type: type[C], presets: Mapping[str, C] | None = None, **node_options: Any
    ) -> None:
        """Create the node.

        Args:
            name: name of the node.
            config_type: configuration from which the parameters are declared.
            presets: configurations selected by the parameter ``preset``, whose values are the defaults.
            node_options: options of rclpy's Node.

        Raises:
            DiffbotError: if the value of a parameter is not allowed.
        """
        super().__init__(name, **node_options)
        try:
            if files := _files_of_process.get():
                files.meet(self.get_fully_qualified_name())
            config_type, presets = self.parameter_set(config_type, presets, overrides_of(self))
            self._checked_parameters = NodeParameters(self, config_type, self._use_config, presets)
        except BaseException:
            self.destroy_node()
            raise
        self.health = Health()
        self.faults = FaultRecord()
        self.clock_watch = ClockWatch(self)
        self.publisher_watch = PublisherWatch(self)
        self.exit_code: int | None = None
        self.steady_clock = Clock(clock_type=ClockType.STEADY_TIME)
        self._diagnostics = self.create_publisher(DiagnosticArray, "/diagnostics", QUEUE)
        self._last_report = self.steady_clock.now().nanoseconds
        self.create_timer(DIAGNOSTICS_PERIOD, self._report, clock=self.steady_clock)

    @property
    def config(self) -> C:
        """The present configuration, always valid."""
        return self._checked_parameters.config

    def parameter_set(
        self, config_type: type[C], presets: Mapping[str, C] | None, overrides: Mapping[str, Any]
    ) -> tuple[type[C], Mapping[str, C] | None]:
        """Return configuration type and presets, for nodes whose parameters depend on one of the ``overrides``.

        Called once, before the parameters are declared.
        """
        return config_type, presets

    def on_config(self, config: C) -> None:
        """Called after a change of parameters, for nodes that keep values derived from them."""

    def _use_config(self, config: C) -> None:
        if self.is_configured:
            self.on_config(config)

    def halt(self) -> None:
        """Called after an internal error, for nodes that move the robot: it has to stop, and nothing may move it."""

    def contain(self, error: Exception, where: str) -> None:
        """Record what the callback of ``where`` raised, so that the node works on; after an internal error, halt."""
        if is_refusal(error):
            kind = error.kind if isinstance(error, BadMessageError) else type(error).__name__
            if self.health.drop(where, f"malformed, {kind}"):
                self.get_logger().warning(f"{where}: refused: {one_line(error)} (logged once; see /diagnostics)")
            return
        self.health.counted["internal errors"] += 1
        if self.faults.add(error, where):
            self.get_logger().error(f"{self.faults.newest} (logged once)\n{self.faults.trace}")
        try:
            self.halt()
        except Exception as failure:
            if self.faults.add(failure, "the halt"):
                self.get_logger().error(f"{self.faults.newest} (logged once)\n{self.faults.trace}")
        if getattr(self.config, "faults", FaultConfig()).exit_on_error:
            self.finish(1)

    def before_shutdown(self) -> None:
        """Called once, while messages can still be sent: to stop the robot or to close a file."""

    def finish(self, exit_code: int) -> None:
        """End the spin loop of :func:`run` with this exit status."""
        self.exit_code = exit_code

    def subscribe(
        self,
        message_type: Any,
        topic: str,
        callback: Callable[[Any], None],
        qos: QoSProfile = QUEUE,
        raw: bool = False,
    ) -> Any:
        """Subscribe; a BadMessageError of ``callback`` drops the message, which is counted and logged once per kind.

        With ``raw`` the callback receives the message's bytes.
        """

        def guarded(message: Any) -> None:
            try:
                callback(message)
            except BadMessageError as error:
                if self.health.drop(topic, error.kind):
                    self.get_logger().warning(f"{topic}: message dropped: {error} (logged once; see /diagnostics)")
            else:
                self.health.accept(topic, time.monotonic())

        return self.create_subscription(message_type, topic, guarded, qos, raw=raw)

    def health_level(self) -> tuple[int, str]:
        """Return level and message for /diagnostics; nodes with a state add it."""
        if self.faults.newest:
            return DiagnosticStatus.ERROR[0], self.faults.newest
        if watches := [one for one in (self.clock_watch, self.publisher_watch) if one.problem]:
            return max(one.level for one in watches), "; ".join(one.problem for one in watches)
        dropped = self.health.recent_drops(time.monotonic())
        if dropped:
            return DiagnosticStatus.WARN[0], f"{dropped} messages dropped in the last {DROP_MEMORY:g} s"
        return DiagnosticStatus.OK[0], "ok"

    def details(self) -> dict[str, str]:
        """Return further key-value pairs for /diagnostics."""
        return {}

    def diagnosis(self) -> tuple[int, str, dict[str, str]]:
        """Return level, message and further key-value pairs for /diagnostics."""
        return *self.health_level(), self.details()

    def _report(self) -> None:
        self.clock_watch.check()
        self.publisher_watch.check(self.is_active)
        now = self.steady_clock.now().nanoseconds
        level, text, details = self.diagnosis()  # first, since it may set notes of the report
        values = self.health.report((now - self._last_report) * 1e-9) | details
        values |= self.health.ages(time.monotonic())
        if self.faults.trace:
            values["traceback"] = self.faults.trace
        self._last_report = now
        message = DiagnosticArray(status=[status_message(self.get_fully_qualified_name(), level, text, values)])
        message.header.stamp = self.get_clock().now().to_msg()
        self._diagnostics.publish(message)


def status_message(name: str, level: int, text: str, values: dict[str, str]) -> DiagnosticStatus:
    """Return a DiagnosticStatus; ``level`` is an integer, which the message holds as one byte."""
    pairs = [KeyValue(key=key, value=value) for key, value in values.items()]
    return DiagnosticStatus(name=name, level=bytes([level]), message=text, values=pairs)


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


def run(factory: Callable[[], DiffbotNode[Any]], args: list[str] | None = None, *, shared_memory: bool = True) -> int:
    """Run one node until a signal or its own :meth:`DiffbotNode.finish`; return the exit status of the process.

    0 after a signal; 1, with one line on stderr, if the node cannot start. ``shared_memory`` as in
    :func:`run_together`.
    """
    return run_together(lambda: (make() for make in (factory,)), args, shared_memory=shared_memory)


def run_together(
    make_nodes: Callable[[], Iterator[DiffbotNode[Any]]], args: list[str] | None = None, *, shared_memory: bool = True
) -> int:
    """Run several nodes on one executor until a signal, or until one of them ends; return the exit status.

    Args:
        make_nodes: creates one after the other; none handles a message before all are there. At the end those that
            move the robot are shut down first, then the others in their order.
        args: as of rclpy.init.
        shared_memory: False makes Fast DDS use UDP alone, unless the environment says otherwise. When a process dies,
            Fast DDS checks its shared memory in each other process, which can block publishing there for a second.

    Returns:
        The largest status of :meth:`DiffbotNode.finish`; otherwise see :func:`run`.
    """
    if not shared_memory:
        os.environ.setdefault("FASTDDS_BUILTIN_TRANSPORTS", "UDPv4")
    try:
        words = sys.argv[1:] if args is None else args
        files = GivenFiles(words[words.index("--ros-args") :] if "--ros-args" in words else ())
    except DiffbotError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    stop = StopFlag()
    try:
        # Invalid arguments are reported once, below.
        set_logger_level("rcl", LoggingSeverity.FATAL)
        rclpy.init(args=args, signal_handler_options=SignalHandlerOptions.NO)
    except Exception as error:  # rclpy raises many types here, all for invalid arguments
        print(f"error: invalid arguments: {_one_line(error)}", file=sys.stderr)
        return 1
    if get_logger_effective_level("rcl") == LoggingSeverity.FATAL:  # unless --log-level rcl:=... was given
        set_logger_level("rcl", LoggingSeverity.UNSET)
    nodes: list[DiffbotNode[Any]] = []
    failed = True
    token = _files_of_process.set(files)
    try:
        for node in make_nodes():
            nodes.append(node)  # one by one: those made before a failure are destroyed, too
        files.check_all_used()
        _spin(nodes, stop)
        failed = False
    except (DiffbotError, ParameterException, InvalidParameterTypeException) as error:
        print(f"error: {_one_line(files.located(error))}", file=sys.stderr)
    finally:
        _files_of_process.reset(token)
        with ExitStack() as last_first:
            # Python restores the default handlers when it exits; a second signal would then change the exit status.
            last_first.callback(stop.ignore)
            last_first.callback(_destroy, nodes, failed)
            for node in sorted(reversed(nodes), key=lambda node: node.moves_the_robot):
                last_first.callback(node.before_shutdown)
    return _status(nodes, failed)


def _status(nodes: list[DiffbotNode[Any]], failed: bool) -> int:
    """Return the exit status; only now, since before_shutdown may fail, such as a recorder on a full disk."""
    return max(int(failed), *(node.exit_code or 0 for node in nodes), 0)


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


def _one_line(text: object) -> str:
    return " ".join(str(text).split())
