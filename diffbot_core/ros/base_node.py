"""rclpy's Node with checked parameters, QoS overrides of all its topics, and callbacks whose errors are contained."""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from typing import Any

from rcl_interfaces.msg import SetParametersResult
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile

from diffbot_core.errors import DiffbotError
from diffbot_core.ros.clock_watch import CLOCK_TOPIC
from diffbot_core.ros.faults import check_size, fill_refusal, one_line
from diffbot_core.ros.parameters import NodeParameters, overrides_of
from diffbot_core.ros.qos import PUBLISHER, SUBSCRIPTION, check_overrides, overridable

RCLError = rclpy_implementation.RCLError


class BaseNode(Node):  # type: ignore[misc]
    """A node that checks changes of its parameters and declares ``qos_overrides`` for its topics.

    Both begin when a subclass has set ``_checked_parameters``; topics that rclpy itself makes before are left alone.
    """

    qos_by_parameters = True
    """Topics have parameters ``qos_overrides...``; not for nodes whose topics are those of a bag."""
    _checked_parameters: NodeParameters[Any] | None = None

    def __init__(self, name: str, **options: Any) -> None:
        """Create the node.

        Raises:
            DiffbotError: in one line, if the middleware refuses it: without DDS Security, when that is enforced.
        """
        try:
            super().__init__(name, **options)
        except RCLError as error:
            raise DiffbotError(f"cannot create the node {name}: {' '.join(str(error).split())}") from error

    def contain(self, error: Exception, where: str) -> None:
        """Handle what the callback of ``where`` (a topic, a service, a timer) raised; here it is raised again."""
        raise error

    def contained(self, callback: Callable[..., Any], where: str) -> Callable[..., Any]:
        """Return ``callback`` with :meth:`contain` around it; one that fails returns None."""

        @wraps(callback)
        def guarded(*arguments: Any) -> Any:
            try:
                return callback(*arguments)
            except Exception as error:
                self.contain(error, where)

        return guarded

    def contained_service(self, callback: Callable[[Any, Any], Any], name: str) -> Callable[[Any, Any], Any]:
        """Return the callback of a service with :meth:`contain` around it; one that fails is answered, too."""

        def guarded(request: Any, response: Any) -> Any:
            try:
                check_size(request)
                return callback(request, response)
            except Exception as error:
                self.contain(error, name)
                return fill_refusal(request, response, one_line(error))

        return guarded

    def set_parameters(self, parameter_list: list[Parameter]) -> list[SetParametersResult]:
        """Change parameters one by one."""
        return [self.set_parameters_atomically([one]) for one in parameter_list]

    def set_parameters_atomically(self, parameter_list: list[Parameter]) -> SetParametersResult:
        """Change parameters together or not at all; the parameter services call it, too.

        The values are checked here, before rclpy checks ranges in words of its own.
        """
        if self._checked_parameters is not None:
            try:
                parameter_list = self._checked_parameters.converted(parameter_list)
            except DiffbotError as error:
                return SetParametersResult(successful=False, reason=str(error))
        return super().set_parameters_atomically(parameter_list)

    def create_publisher(self, msg_type: Any, topic: str, qos_profile: QoSProfile | int, **options: Any) -> Any:
        """Create a publisher.

        Raises:
            InvalidValueError: naming the parameter, if the value of a QoS override is not allowed.
        """
        if self._has_qos_parameters(topic, PUBLISHER):
            qos_profile, options["qos_overriding_options"] = overridable(qos_profile)
        return super().create_publisher(msg_type, topic, qos_profile, **options)

    def create_subscription(
        self, msg_type: Any, topic: str, callback: Any, qos_profile: QoSProfile | int, **options: Any
    ) -> Any:
        """Create a subscription.

        Raises:
            InvalidValueError: naming the parameter, if the value of a QoS override is not allowed.
        """
        if self._has_qos_parameters(topic, SUBSCRIPTION):
            qos_profile, options["qos_overriding_options"] = overridable(qos_profile)
        return super().create_subscription(msg_type, topic, self.contained(callback, topic), qos_profile, **options)

    def create_service(self, srv_type: Any, srv_name: str, callback: Any, **options: Any) -> Any:
        """Create a service."""
        return super().create_service(srv_type, srv_name, self.contained_service(callback, srv_name), **options)

    def create_timer(self, timer_period_sec: float, callback: Any, *arguments: Any, **options: Any) -> Any:
        """Create a timer."""
        name = f"the timer {getattr(callback, '__name__', 'callback').strip('_')}"
        return super().create_timer(timer_period_sec, self.contained(callback, name), *arguments, **options)

    def _has_qos_parameters(self, topic: str, entity: str) -> bool:
        # rclpy subscribes to /clock whenever use_sim_time is set.
        if not self.qos_by_parameters or self._checked_parameters is None or topic == CLOCK_TOPIC:
            return False
        check_overrides(overrides_of(self), self.resolve_topic_name(topic), entity)
        return True
