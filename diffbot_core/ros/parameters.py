"""ROS parameters from configuration types: declared, checked and kept in step with ``ros2 param set``."""

from __future__ import annotations

from array import array
from collections.abc import Callable, Mapping
from typing import Any, Generic

from rcl_interfaces.msg import ParameterDescriptor, SetParametersResult
from rclpy.node import Node

from diffbot_core.errors import DiffbotError
from diffbot_core.schema import C, Parameter, build, checked, parameters_of, refuse_replaced, to_dict


def overrides_of(node: Node) -> dict[str, Any]:
    """Return the values given to ``node`` from outside, declared or not, by name."""
    # rclpy ignores an override that is never declared and has no public way to list them.
    given = getattr(node, "_parameter_overrides", {})
    return {name: parameter.value for name, parameter in given.items()}


class NodeParameters(Generic[C]):
    """The parameters of one node as one configuration, valid at all times.

    A bad value at the start raises; a bad ``ros2 param set`` is refused with the same text and changes nothing.
    """

    def __init__(
        self,
        node: Node,
        config_type: type[C],
        on_change: Callable[[C], None],
        presets: Mapping[str, C] | None = None,
    ) -> None:
        """Declare every field of ``config_type`` on ``node``; ``on_change`` receives each later configuration.

        With ``presets`` the parameter ``preset`` is declared first, and the defaults of the others are that preset's.

        Raises:
            InvalidValueError: naming parameter, value and bound, if an override from outside is not allowed, or is
                given under a name that was replaced.
        """
        self._node = node
        refuse_replaced(config_type, overrides_of(node))
        self._fields: dict[str, Parameter] = {parameter.name: parameter for parameter in parameters_of(config_type)}
        self._on_change = on_change
        self._type = config_type
        base = config_type()
        if presets is not None:
            parameter = self._fields["preset"]
            base = presets[checked(parameter, self._declare(parameter, parameter.default))]
        defaults = to_dict(base)
        values = {
            name: self._declare(parameter, defaults[name])
            for name, parameter in self._fields.items()
            if presets is None or name != "preset"
        }
        self.config: C = build(config_type, values, base)
        self._warn_of_unknown_overrides()
        node.add_on_set_parameters_callback(self._validate)
        node.add_post_set_parameters_callback(self._apply)

    def _declare(self, parameter: Parameter, default: Any) -> Any:
        spec = parameter.spec
        default = list(default) if isinstance(default, tuple) else default
        descriptor = ParameterDescriptor(
            description=f"{spec.text} [{spec.unit}]",
            additional_constraints=spec.bound() if parameter.type in (float, int) or spec.choices else "",
            read_only=spec.read_only,
            # Whole numbers are accepted for floats; schema.checked() checks the types.
            dynamic_typing=True,
        )
        value = self._node.declare_parameter(parameter.name, default, descriptor).value
        # rcl knows no type for [] and drops it.
        return () if value is None and isinstance(parameter.default, tuple) else value

    def _warn_of_unknown_overrides(self) -> None:
        for name in sorted(overrides_of(self._node)):
            if not self._node.has_parameter(name):
                self._node.get_logger().warning(f"unknown parameter '{name}' is ignored")

    def _ours(self, changes: list[Any]) -> dict[str, Any]:
        # rclpy gives lists as array.array, which prints differently from the list given at the start.
        return {
            change.name: change.value.tolist() if isinstance(change.value, array) else change.value
            for change in changes
            if change.name in self._fields
        }

    def _validate(self, changes: list[Any]) -> SetParametersResult:
        ours = self._ours(changes)
        try:
            build(self._type, ours, self.config)
        except DiffbotError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    def _apply(self, changes: list[Any]) -> None:
        ours = self._ours(changes)
        if ours:
            self.config = build(self._type, ours, self.config)
            self._on_change(self.config)
