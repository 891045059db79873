"""Base class of all nodes: checks parameters, catches errors of callbacks, counts messages, reports on /diagnostics."""

from __future__ import annotations

import time
import traceback
from collections.abc import Callable, Mapping
from functools import wraps
from typing import Any, Generic, cast

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rcl_interfaces.msg import SetParametersResult
from rclpy.clock import Clock, ClockType
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile

from diffbot_core.endpoints import input_problem
from diffbot_core.errors import BadMessageError, DiffbotError
from diffbot_core.health import DROP_MEMORY, Health
from diffbot_core.ros.graph import published_elsewhere, publishers_of, subscriptions_of
from diffbot_core.ros.parameters import CheckedParameters, overrides_of
from diffbot_core.ros.qos import PUBLISHER, QUEUE, SUBSCRIPTION, overridable
from diffbot_core.ros.watches import CLOCK_TOPIC, ClockWatch, PublisherWatch
from diffbot_core.schema import C
from diffbot_core.yaml_files import ParameterFiles

MAX_ENTRIES = 1000
"""Largest number of entries in a request to a parameter service; a million entries would block a node for seconds."""
DIAGNOSTICS_PERIOD = 1.0
"""[s] between two /diagnostics messages of a node"""
_BASE_MODULES = (__name__, "diffbot_core.ros.run")
"""Modules whose functions are in the traceback of every callback."""


class DiffbotNode(Node, Generic[C]):  # type: ignore[misc]
    """A node with checked parameters (``config``), error handling and a report on /diagnostics once a second.

    An exception that leaves a callback would end rclpy's spinning, and its EventsExecutor would call no further
    callback. So the node wraps all callbacks by :meth:`contained`, including the callbacks that rclpy registers
    (parameter services, /clock).
    """

    files: ParameterFiles | None = None
    """parameter files of this process, set by :func:`diffbot_core.ros.run.run`"""
    qos_by_parameters = True
    """False for the nodes that record or replay, which have no parameters ``qos_overrides...``"""
    is_configured = True
    """False while a managed node is unconfigured"""
    is_active = True
    """False while a managed node is not active"""
    moves_the_robot = False
    """True for a node that must stop the robot before other nodes end"""
    _checked_parameters: CheckedParameters[C] | None = None
    _configuration: object | None = None
    """identity of the present configuration of a managed node; callbacks of an earlier configuration do nothing"""

    def __init__(self, name: str, config_type: type[C], **node_options: Any) -> None:
        """Create the node.

        Args:
            name: name of the node.
            config_type: configuration type that defines the parameters, see :meth:`parameter_set`.
            node_options: options of rclpy's Node.

        Raises:
            DiffbotError: if the value of a parameter is not allowed, or if the middleware refuses the node, for example
                because DDS Security is required and not configured.
        """
        self.health = Health()
        self.faults = FaultRecord()
        self.exit_code: int | None = None
        self._subscribed: dict[str, Any] = {}
        try:
            super().__init__(name, **node_options)
        except rclpy_implementation.RCLError as error:
            raise DiffbotError(f"cannot create the node {name}: {' '.join(str(error).split())}") from error
        try:
            if self.files is not None:
                self.files.add_node(self.get_fully_qualified_name())
            config_type, presets = self.parameter_set(config_type, overrides_of(self))
            self._checked_parameters = CheckedParameters(self, config_type, self._use_config, presets)
        except BaseException:
            self.destroy_node()
            raise
        self.clock_watch = ClockWatch(self)
        self.publisher_watch = PublisherWatch(self)
        self.steady_clock = Clock(clock_type=ClockType.STEADY_TIME)
        self._diagnostics = self.create_publisher(DiagnosticArray, "/diagnostics", QUEUE)
        self._last_report = time.monotonic()
        self.create_timer(DIAGNOSTICS_PERIOD, self._report, clock=self.steady_clock)

    @property
    def config(self) -> C:
        """The present configuration, which is always valid."""
        return self.checked_parameters.config

    @property
    def checked_parameters(self) -> CheckedParameters[C]:
        """The ROS parameters of the node."""
        return cast("CheckedParameters[C]", self._checked_parameters)

    def parameter_set(
        self, config_type: type[C], overrides: Mapping[str, Any]
    ) -> tuple[type[C], Mapping[str, C] | None]:
        """Return the configuration type and the presets to use; the constructor calls this method once.

        A node whose parameters depend on other parameters overrides this method. ``overrides`` are the values that the
        user has given. Presets are the defaults of all parameters for each value of the parameter ``preset``; None if
        the node does not have this parameter.
        """
        return config_type, None

    def on_config(self, config: C) -> None:
        """Update values that depend on parameters; called after each change of a parameter."""

    def _use_config(self, config: C) -> None:
        if self.is_configured:
            self.on_config(config)

    def halt(self) -> None:
        """Stop the robot; called after an internal error."""

    def before_shutdown(self) -> None:
        """Stop the robot or close files; called once at the end, while messages can still be sent."""

    def finish(self, exit_code: int) -> None:
        """End the process with an exit status as soon as the present callback returns."""
        self.exit_code = exit_code

    def contained(self, callback: Callable[..., Any], where: str, *, counted: bool = False) -> Callable[..., Any]:
        """Wrap a callback so that :meth:`contain` handles its exceptions.

        Args:
            callback: function of the node.
            where: topic, service or timer of the callback.
            counted: count each message that the callback accepts.
        """
        configuration = self._configuration

        @wraps(callback)
        def call(*arguments: Any) -> Any:
            if configuration is not None and configuration is not self._configuration:
                # The executor had already selected this callback when the cleanup destroyed its entity.
                return None
            try:
                result = callback(*arguments)
            except Exception as error:
                self.contain(error, where)
                return None
            if counted:
                self.health.accept(where, time.monotonic())
            return result

        return call

    def contain(self, error: Exception, where: str) -> None:
        """Handle an exception of the callback ``where``: count a bad message, or halt after an internal error."""
        if is_bad_input(error):
            kind = error.kind if isinstance(error, BadMessageError) else f"malformed, {type(error).__name__}"
            text = " ".join(str(error).split())
            if self.health.drop(where, kind, text):
                self.get_logger().warning(f"{where}: message dropped: {text} (logged once; see /diagnostics)")
            return
        self.health.counted["internal errors"] += 1
        self._log_fault(error, where)
        try:
            self.halt()
        except Exception as failure:
            self._log_fault(failure, "halt()")
        faults = getattr(self.config, "faults", None)
        if faults is not None and faults.exit_on_error:
            self.finish(1)

    def _log_fault(self, error: Exception, where: str) -> None:
        if self.faults.add(error, where):
            self.get_logger().error(f"{self.faults.newest} (logged once)\n{self.faults.trace}")

    def contained_service(self, callback: Callable[[Any, Any], Any], name: str) -> Callable[[Any, Any], Any]:
        """Wrap the callback of a service so that a failed call returns a response, too."""

        def call(request: Any, response: Any) -> Any:
            try:
                for field in ("parameters", "names", "prefixes"):
                    if (length := len(getattr(request, field, ()))) > MAX_ENTRIES:
                        raise BadMessageError("too long", f"{field} of length {length}: must be <= {MAX_ENTRIES}")
                return callback(request, response)
            except Exception as error:
                self.contain(error, name)
                return refusal(request, response, one_line(error))

        return call

    def subscribe(
        self, message_type: Any, topic: str, callback: Callable[[Any], None], qos: QoSProfile = QUEUE, raw: bool = False
    ) -> Any:
        """Create a subscription whose messages are counted in /diagnostics.

        If the callback raises a BadMessageError, the node counts the message as dropped and logs the first message of
        this kind. With ``raw``, the callback receives the serialized message.
        """
        subscription = self._subscribe(message_type, topic, self.contained(callback, topic, counted=True), qos, raw=raw)
        self._subscribed[topic] = subscription
        return subscription

    def input_problem(self, topic: str) -> str:
        """Return why the node accepts no messages of a topic: dropped, or no matching publisher; otherwise empty."""
        if dropped := self.health.newest_drop(topic, time.monotonic()):
            return f"drops {topic}: {dropped}"
        if (subscription := self._subscribed.get(topic)) is None:
            return ""
        name, full_topic = self.get_fully_qualified_name(), subscription.topic_name
        own = [one for one in subscriptions_of(self, full_topic) if one.node == name]
        if not own:
            return ""
        publishers = publishers_of(self, full_topic)
        elsewhere = () if publishers else published_elsewhere(self, full_topic, own[0].type)
        return input_problem(full_topic, own[0], publishers, elsewhere)

    def create_subscription(
        self, msg_type: Any, topic: str, callback: Any, qos_profile: QoSProfile | int, **options: Any
    ) -> Any:
        """Create a subscription whose messages are not counted."""
        return self._subscribe(msg_type, topic, self.contained(callback, topic), qos_profile, **options)

    def _subscribe(self, kind: Any, topic: str, callback: Any, qos: QoSProfile | int, **options: Any) -> Any:
        qos = self._with_overrides(topic, SUBSCRIPTION, qos, options)
        return super().create_subscription(kind, topic, callback, qos, **options)

    def create_publisher(self, msg_type: Any, topic: str, qos_profile: QoSProfile | int, **options: Any) -> Any:
        """Create a publisher.

        Raises:
            InvalidValueError: if the value of a QoS override is not allowed.
        """
        qos = self._with_overrides(topic, PUBLISHER, qos_profile, options)
        return super().create_publisher(msg_type, topic, qos, **options)

    def _with_overrides(self, topic: str, entity: str, qos: QoSProfile | int, options: dict[str, Any]) -> Any:
        """Return the profile, and add rclpy's option for the parameters ``qos_overrides...`` to ``options``."""
        # rclpy itself subscribes to /clock, and creates publishers before the parameters are declared.
        if not self.qos_by_parameters or self._checked_parameters is None or topic == CLOCK_TOPIC:
            return qos
        name = self.resolve_topic_name(topic)
        qos, options["qos_overriding_options"] = overridable(qos, overrides_of(self), name, entity)
        return qos

    def create_service(self, srv_type: Any, srv_name: str, callback: Any, **options: Any) -> Any:
        """Create a service."""
        return super().create_service(srv_type, srv_name, self.contained_service(callback, srv_name), **options)

    def create_timer(self, timer_period_sec: float, callback: Any, *arguments: Any, **options: Any) -> Any:
        """Create a timer."""
        name = f"the timer {getattr(callback, '__name__', 'callback').strip('_')}"
        return super().create_timer(timer_period_sec, self.contained(callback, name), *arguments, **options)

    def set_parameters(self, parameter_list: list[Parameter]) -> list[SetParametersResult]:
        """Change parameters one by one."""
        return [self.set_parameters_atomically([one]) for one in parameter_list]

    def set_parameters_atomically(self, parameter_list: list[Parameter]) -> SetParametersResult:
        """Change all parameters or none; the parameter services call this method, too.

        The values are checked before rclpy checks them, because the messages of rclpy name neither value nor bound.
        """
        if self._checked_parameters is not None:
            try:
                parameter_list = self._checked_parameters.converted(parameter_list)
            except DiffbotError as error:
                return SetParametersResult(successful=False, reason=str(error))
        return super().set_parameters_atomically(parameter_list)

    def health_level(self) -> tuple[int, str]:
        """Return level and message for /diagnostics; some nodes add their state."""
        if self.faults.newest:
            return DiagnosticStatus.ERROR[0], self.faults.newest
        if watches := [one for one in (self.clock_watch, self.publisher_watch) if one.problem]:
            return max(one.level for one in watches), "; ".join(one.problem for one in watches)
        if dropped := self.health.recent_drops(time.monotonic()):
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
        now = time.monotonic()
        level, text, details = self.diagnosis()
        values = self.health.report(now - self._last_report) | details | self.health.ages(now)
        if self.faults.trace:
            values["traceback"] = self.faults.trace
        self._last_report = now
        message = DiagnosticArray(status=[status_message(self.get_fully_qualified_name(), level, text, values)])
        message.header.stamp = self.get_clock().now().to_msg()
        self._diagnostics.publish(message)


class FaultRecord:
    """The newest internal error of a node, and the places in the code where internal errors occurred."""

    def __init__(self) -> None:
        """Start without an error."""
        self.newest = ""
        """newest error in one line; empty if no error occurred"""
        self.trace = ""
        """traceback of the newest error"""
        self._known: set[tuple[str, str, int]] = set()

    def add(self, error: Exception, where: str) -> bool:
        """Add an error of a callback; return True if it is the first error of its type at its line of code."""
        self.newest = f"internal error in {where}: {one_line(error)}"
        self.trace = "".join(traceback.format_exception(error))
        place = traceback.extract_tb(error.__traceback__)[-1]
        key = type(error).__name__, place.filename, place.lineno or 0
        is_new = key not in self._known
        self._known.add(key)
        return is_new


def is_bad_input(error: Exception) -> bool:
    """Return True if malformed input caused an error: it is a BadMessageError, or rclpy raised it.

    rclpy raised the error if the traceback contains no code of this project except _BASE_MODULES.
    """
    if isinstance(error, BadMessageError):
        return True
    names = (str(frame.f_globals.get("__name__", "")) for frame, _ in traceback.walk_tb(error.__traceback__))
    return not any(name == "__main__" or (name.startswith("diffbot_") and name not in _BASE_MODULES) for name in names)


def refusal(request: Any, response: Any, reason: str) -> Any:
    """Return the response of a failed service call, with the ``reason`` if the response has a field for it."""
    result = SetParametersResult(successful=False, reason=reason)
    if hasattr(response, "results") and hasattr(request, "parameters"):
        response.results.extend([result] * (min(len(request.parameters), MAX_ENTRIES) - len(response.results)))
    elif hasattr(response, "result") and isinstance(response.result, SetParametersResult):
        response.result = result
    elif hasattr(response, "success") and hasattr(response, "message"):
        response.success, response.message = False, reason
    return response


def one_line(error: BaseException) -> str:
    """Return type and text of an error in one line."""
    return f"{type(error).__name__}: {' '.join(str(error).split())}"


def status_message(name: str, level: int, text: str, values: dict[str, str]) -> DiagnosticStatus:
    """Return a DiagnosticStatus, whose level is one byte, from an integer ``level``."""
    pairs = [KeyValue(key=key, value=value) for key, value in values.items()]
    return DiagnosticStatus(name=name, level=bytes([level]), message=text, values=pairs)
