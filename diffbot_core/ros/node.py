"""What all nodes of diffbot share: guarded subscriptions, health reports, executor choice, signals and exit codes."""

from __future__ import annotations

import os
import signal
import sys
import time
from collections.abc import Callable, Mapping
from typing import Any, Generic

import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.clock import Clock, ClockType
from rclpy.exceptions import InvalidParameterTypeException, ParameterException
from rclpy.executors import Executor, SingleThreadedExecutor
from rclpy.logging import LoggingSeverity, get_logger_effective_level, set_logger_level
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.signals import SignalHandlerOptions

from diffbot_core.errors import BadMessageError, DiffbotError
from diffbot_core.health import Health
from diffbot_core.ros.parameters import NodeParameters
from diffbot_core.schema import C

DIAGNOSTICS_PERIOD = 1.0
"""[s] between two /diagnostics messages of a node."""
SPIN_TIMEOUT = 0.05
"""[s] after which the spin loop looks at the signal flag even if no message comes."""
QUEUE = QoSProfile(depth=10)
"""Reliable, volatile: the default of what is sent and heard here."""
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
"""The last message is kept for those who come later."""


class DiffbotNode(Node, Generic[C]):  # type: ignore[misc]
    """A node with checked parameters (``self.config``), guarded subscriptions and a 1 Hz report on /diagnostics."""

    def __init__(
        self, name: str, config_type: type[C], presets: Mapping[str, C] | None = None, **node_options: Any
    ) -> None:
        """Create the node; ``presets``: defaults by the parameter ``preset``, ``node_options``: those of rclpy's Node.

        Raises:
            DiffbotError: if a parameter is not allowed.
        """
        super().__init__(name, **node_options)
        try:
            self._checked_parameters = NodeParameters(self, config_type, self.on_config, presets)
        except BaseException:
            self.destroy_node()
            raise
        self.health = Health()
        self.exit_code: int | None = None
        self.steady_clock = Clock(clock_type=ClockType.STEADY_TIME)
        self._diagnostics = self.create_publisher(DiagnosticArray, "/diagnostics", QUEUE)
        self._last_report = self.steady_clock.now().nanoseconds
        self.create_timer(DIAGNOSTICS_PERIOD, self._report, clock=self.steady_clock)

    @property
    def config(self) -> C:
        """The valid configuration of this moment."""
        return self._checked_parameters.config

    def on_config(self, config: C) -> None:
        """Called after parameters were changed from outside; for nodes that keep something derived from them."""

    def before_shutdown(self) -> None:
        """Called once while messages can still be sent: stop the robot, close the file."""

    def finish(self, exit_code: int) -> None:
        """End the spin loop of :func:`run` with this exit status."""
        self.exit_code = exit_code

    def subscribe(
        self,
        message_type: Any,
        topic: str,
        callback: Callable[[Any], None],
        qos: QoSProfile = QUEUE,
    ) -> Any:
        """Subscribe; a BadMessageError from ``callback`` drops the message: counted, and said once per kind."""

        def guarded(message: Any) -> None:
            try:
                callback(message)
            except BadMessageError as error:
                if self.health.drop(topic, error.kind):
                    self.get_logger().warning(f"{topic}: message dropped: {error} (said once; see /diagnostics)")
            else:
                self.health.accept(topic, time.monotonic())

        return self.create_subscription(message_type, topic, guarded, qos)

    def health_level(self) -> tuple[int, str]:
        """Level and one line for /diagnostics; nodes with a state of their own say more."""
        dropped = sum(self.health.dropped.values())
        if dropped:
            return DiagnosticStatus.WARN[0], f"{dropped} messages dropped"
        return DiagnosticStatus.OK[0], "ok"

    def details(self) -> dict[str, str]:
        """Return what a node shows in /diagnostics beside its counts; for nodes that have something."""
        return {}

    def _report(self) -> None:
        now = self.steady_clock.now().nanoseconds
        level, text = self.health_level()  # first: it may write the notes that the report shows
        values = self.health.report((now - self._last_report) * 1e-9) | self.details()
        values |= self.health.ages(time.monotonic())
        self._last_report = now
        message = DiagnosticArray(status=[status_message(self.get_fully_qualified_name(), level, text, values)])
        message.header.stamp = self.get_clock().now().to_msg()
        self._diagnostics.publish(message)


def status_message(name: str, level: int, text: str, values: dict[str, str]) -> DiagnosticStatus:
    """Fill a DiagnosticStatus; ``level`` is its number, which the message holds as one byte."""
    pairs = [KeyValue(key=key, value=value) for key, value in values.items()]
    return DiagnosticStatus(name=name, level=bytes([level]), message=text, values=pairs)


def make_executor(context: rclpy.Context | None = None) -> Executor:
    """Return the executor all nodes run on: rclpy's EventsExecutor, or the default where it is missing.

    Driven by ``spin_once(timeout_sec=...)`` it needs about a third of the CPU of the default one; its ``spin()`` must
    not be used (rclpy 7.1.6: no callback runs). ``DIFFBOT_EXECUTOR=single`` asks for the SingleThreadedExecutor.
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
    """Set by SIGINT and SIGTERM; further signals are swallowed, so that a clean end is not cut short.

    rclpy's own handlers shut the context down at once, and then no stop command can be sent and no bag be told.
    """

    def __init__(self) -> None:
        """Install the handlers of this process."""
        self.is_set = False
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, self._on_signal)

    def _on_signal(self, _number: int, _frame: object) -> None:
        self.is_set = True

    def ignore(self) -> None:
        """Let signals pass without effect until the process ends."""
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, signal.SIG_IGN)


def run(factory: Callable[[], DiffbotNode[Any]], args: list[str] | None = None) -> int:
    """Run one node until a signal or its own :meth:`DiffbotNode.finish`; return the exit status of the process.

    0 after a signal; 1 with one line on stderr if the node refuses to start.
    """
    stop = StopFlag()
    try:
        # What is wrong with the arguments is said once, below.
        set_logger_level("rcl", LoggingSeverity.FATAL)
        rclpy.init(args=args, signal_handler_options=SignalHandlerOptions.NO)
    except Exception as error:  # rclpy raises many types here, all of them mean unusable arguments
        print(f"error: unusable arguments: {_one_line(error)}", file=sys.stderr)
        return 1
    if get_logger_effective_level("rcl") == LoggingSeverity.FATAL:  # unless --log-level rcl:=... was given
        set_logger_level("rcl", LoggingSeverity.UNSET)
    node: DiffbotNode[Any] | None = None
    try:
        node = factory()
        executor = make_executor()
        executor.add_node(node)
        node.get_logger().info("ready")
        while not stop.is_set and node.exit_code is None:
            executor.spin_once(timeout_sec=SPIN_TIMEOUT)
    except (DiffbotError, ParameterException, InvalidParameterTypeException) as error:
        print(f"error: {_one_line(error)}", file=sys.stderr)
        return 1
    finally:
        if node is not None:
            node.before_shutdown()
            node.destroy_node()
        rclpy.try_shutdown()
        # Python gives its own handlers up before it ends; a late second signal would then kill what ended well.
        stop.ignore()
    # Only now: a node may still fail in before_shutdown, such as a recorder on a full disk.
    return node.exit_code or 0


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split())
