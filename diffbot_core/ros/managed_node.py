"""Base class of managed nodes, which Nav2's lifecycle manager can configure, activate and deactivate.

The states are defined in https://design.ros2.org/articles/node_lifecycle.html. An *unconfigured* node has parameters
and diagnostics only. An *inactive* node receives messages but does not act. An *active* node works. With the parameter
``autostart``, a node configures and activates itself at the start.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from lifecycle_msgs.srv import ChangeState
from rclpy.lifecycle import LifecycleNodeMixin, LifecycleState, TransitionCallbackReturn

from diffbot_core.errors import DiffbotError
from diffbot_core.ros.node import DiffbotNode, one_line
from diffbot_core.schema import C

UNCONFIGURED, INACTIVE = "unconfigured", "inactive"
_TASK_ROUNDS = 10
"""Calls of the executor at the end; the result of an action needs a few."""
_SUCCESS, _FAILURE, _ERROR = (
    TransitionCallbackReturn.SUCCESS,
    TransitionCallbackReturn.FAILURE,
    TransitionCallbackReturn.ERROR,
)


class ManagedNode(LifecycleNodeMixin, DiffbotNode[C]):  # type: ignore[misc]
    """A DiffbotNode with the states and services of a lifecycle node.

    A subclass creates its publishers, subscriptions, services and timers in :meth:`configure`; this class destroys
    them after :meth:`cleanup`. The configuration of the node has the fields of LifecycleConfig.
    """

    def __init__(self, name: str, config_type: type[C], **node_options: Any) -> None:
        """Create the node; arguments as for :class:`DiffbotNode`.

        Raises:
            DiffbotError: if the value of a parameter is not allowed, or the node cannot be configured or activated.
        """
        self.is_active = self.is_configured = False
        self._failure: DiffbotError | None = None
        """why the newest transition failed; None if it succeeded"""
        DiffbotNode.__init__(self, name, config_type, **node_options)
        LifecycleNodeMixin.__init__(self)
        self._guard_requests()
        self._permanent_entities = self._entities()
        if self.get_parameter("autostart").value:
            for transition in (self.trigger_configure, self.trigger_activate):
                if transition() != _SUCCESS:
                    self.destroy_node()
                    raise self._failure or DiffbotError(f"{transition.__name__} failed")

    def configure(self) -> None:
        """Create publishers, subscriptions and other resources from the present configuration.

        Raises:
            DiffbotError: if a resource cannot be created; the node stays unconfigured.
        """

    def activate(self) -> None:
        """Start to work."""

    def deactivate(self) -> None:
        """Stop working; messages can still be sent."""

    def cleanup(self) -> None:
        """Release resources other than publishers, subscriptions, clients, services and timers."""

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Configure the node; if that fails, destroy what was created."""
        self._failure = None
        self._configuration = object()
        result = self._attempt(self.configure)
        self.is_configured = result == _SUCCESS
        if not self.is_configured:
            self._destroy_entities()
        return result

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Activate the node."""
        self._failure = None
        self.is_active = True
        result = self._attempt(self.activate)
        self.is_active = result == _SUCCESS
        return result

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Deactivate the node."""
        self._failure = None
        return self._end_activity()

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Destroy what :meth:`configure` created."""
        self._failure = None
        return self._end_configuration()

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Deactivate and clean up. The process then waits for a signal, as the processes of Nav2 do."""
        self._failure = None
        return self.on_error(state)

    def on_error(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Return to unconfigured after a transition that raised an exception; /diagnostics still reports the reason."""
        deactivated = self._end_activity() if self.is_active else _SUCCESS
        cleaned_up = self._end_configuration()
        return cleaned_up if deactivated == _SUCCESS else deactivated

    def _end_activity(self) -> TransitionCallbackReturn:
        self.is_active = False
        return _ended(self._attempt(self.deactivate))

    def _end_configuration(self) -> TransitionCallbackReturn:
        was_configured, self.is_configured = self.is_configured, False
        result = self._attempt(self.cleanup) if was_configured else _SUCCESS
        self._destroy_entities()
        return _ended(result)

    def before_shutdown(self) -> None:
        """Deactivate and clean up before the process ends."""
        if self.is_active:
            self.is_active = False
            self.deactivate()
            if self.moves_the_robot:
                self._run_tasks()
        if self.is_configured:
            self.is_configured = False
            self.cleanup()

    def _run_tasks(self) -> None:
        """Run the tasks that the deactivation has created, such as the result of a cancelled action goal.

        A node that moves the robot is the first to end, so the other nodes of the process still handle messages.
        """
        for _ in range(_TASK_ROUNDS):
            if self.executor is not None:
                self.executor.spin_once(timeout_sec=0.0)

    def destroy_node(self) -> None:
        """Destroy the node and its state machine; rclpy would keep the publisher of ~/transition_event."""
        # The services of the node use handles of the state machine, so they are destroyed first.
        super().destroy_node()
        # The state machine is missing if a parameter was refused.
        machine = getattr(self, "_state_machine", None)
        if machine is not None:
            machine.destroy_when_not_in_use()

    def diagnosis(self) -> tuple[int, str, dict[str, str]]:
        """Return level, message and values for /diagnostics.

        A node that is not active reports only a failed transition as a problem, until the next transition.
        """
        if self.is_active:
            return super().diagnosis()
        state, values = UNCONFIGURED, dict[str, str]()
        if self.is_configured:
            state, values = INACTIVE, super().diagnosis()[2]
        if self._failure is None:
            return DiagnosticStatus.OK[0], state, values
        return DiagnosticStatus.ERROR[0], f"{state}; {self._failure}", values

    def _attempt(self, work: Callable[[], None]) -> TransitionCallbackReturn:
        """Do the work of a transition and store its first failure; rclpy would drop the exception."""
        name, result = work.__name__, _SUCCESS
        try:
            work()
        except DiffbotError as error:
            failure, result = error, _FAILURE
        except Exception as error:
            self.contain(error, name)
            failure, result = DiffbotError(one_line(error)), _ERROR
            failure.__cause__ = error
        if result != _SUCCESS:
            self.get_logger().error(f"{name}: {failure}")
            self._failure = self._failure or failure
        return result

    def _entities(self) -> dict[Any, Callable[[Any], Any]]:
        """Return all publishers, subscriptions, clients, services and timers, with the function that destroys each."""
        kinds = (
            (self.publishers, self.destroy_publisher),
            (self.subscriptions, self.destroy_subscription),
            (self.clients, self.destroy_client),
            (self.services, self.destroy_service),
            (self.timers, self.destroy_timer),
        )
        return {entity: destroy for entities, destroy in kinds for entity in entities}

    def _destroy_entities(self) -> None:
        """Destroy all entities that were created after the constructor."""
        self._configuration = None
        for entity, destroy in self._entities().items():
            if entity not in self._permanent_entities:
                destroy(entity)

    def _guard_requests(self) -> None:
        """Refuse a transition that is not possible in the present state; it would end the process in rclpy 7.1."""
        service = next(one for one in self.services if one.srv_type is ChangeState)
        change: Callable[[Any, Any], Any] = service.callback

        def guarded(request: Any, response: Any) -> Any:
            requested = request.transition.label or request.transition.id
            if any(requested in transition[:2] for transition in self._state_machine.available_transitions):
                return change(request, response)
            state = self._state_machine.current_state[1]
            self.get_logger().warning(f"transition {requested} refused: it is not possible in the state {state}")
            response.success = False
            return response

        service.callback = guarded
        for one in self.services:
            if one.srv_type.__module__.startswith("lifecycle_msgs."):
                # rclpy does not create these services by create_service().
                one.callback = self.contained_service(one.callback, one.service_name)


def _ended(result: TransitionCallbackReturn) -> TransitionCallbackReturn:
    """Convert FAILURE to ERROR: after a failed deactivation or cleanup, the node cannot keep its previous state."""
    return _ERROR if result == _FAILURE else result
