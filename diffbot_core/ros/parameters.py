"""Declare, check and change ROS parameters that a configuration type defines."""

from __future__ import annotations

import math
import re
from array import array
from collections.abc import Callable, Mapping
from typing import Any, Generic, get_origin

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.node import Node
from rclpy.parameter import Parameter as RosParameter

from diffbot_core.installed import entry_points_by_name
from diffbot_core.schema import C, Parameter, build, checked, parameters_of, to_dict

_QOS_OVERRIDE = re.compile(r"qos_overrides\./.+\.(publisher|subscription)(_\w+)?\.[a-z_]+")
"""Parameters that rclpy declares when it creates a publisher or subscription."""
CONFIGS = "diffbot.parameters"
"""Group of entry points that map the name of a node to ``package.module:Config``."""


def is_qos_override(name: str) -> bool:
    """Return True if rclpy declares the parameter when it creates a publisher or subscription."""
    return _QOS_OVERRIDE.fullmatch(name) is not None


def overrides_of(node: Node) -> dict[str, Any]:
    """Return the parameter values that the user has given to ``node``, including parameters that are not declared."""
    # rclpy does not have a public method for this.
    given = getattr(node, "_parameter_overrides", {})
    return {name: parameter.value for name, parameter in given.items()}


class CheckedParameters(Generic[C]):
    """The parameters of one node as a configuration, which is always valid.

    An invalid value raises an error at the start; later, an invalid change is refused with the same text.
    """

    def __init__(
        self,
        node: Node,
        config_type: type[C],
        on_change: Callable[[C], None],
        presets: Mapping[str, C] | None,
    ) -> None:
        """Declare every field of ``config_type`` on ``node``.

        Args:
            node: the node.
            config_type: the configuration type.
            on_change: called with the new configuration after each change of a parameter.
            presets: defaults of all other parameters for each value of the parameter ``preset``; None without it.

        Raises:
            InvalidValueError: if a given value is not allowed.
        """
        self._node = node
        self._overrides = overrides_of(node)
        self._fields: dict[str, Parameter] = {parameter.name: parameter for parameter in parameters_of(config_type)}
        self._on_change = on_change
        self._type = config_type
        base = config_type()
        if presets is not None:
            parameter = self._fields["preset"]
            base = presets[self._declare(parameter, parameter.default)]
        defaults = to_dict(base)
        values = {
            name: self._declare(parameter, defaults[name])
            for name, parameter in self._fields.items()
            if presets is None or name != "preset"
        }
        self.config: C = build(config_type, values, base)
        node.add_post_set_parameters_callback(self._apply)

    def _declare(self, parameter: Parameter, default: Any) -> Any:
        """Declare a parameter with the given value or the default, and return the value."""
        value = self._overrides.get(parameter.name, default)
        if value is None and get_origin(parameter.type) is tuple:
            # rcl does not have a type for an empty list, so the override is without a value.
            value = ()
        value = checked(parameter, value)
        stored = list(value) if isinstance(value, tuple) else value
        self._node.declare_parameter(parameter.name, stored, descriptor_of(parameter), ignore_override=True)
        return value

    @property
    def unknown(self) -> dict[str, Any]:
        """Given values whose names are not parameters of any node of this package.

        Parameters of other nodes are allowed, because a section /** of a file applies to all nodes.
        """
        undeclared = {name: value for name, value in self._overrides.items() if not self._node.has_parameter(name)}
        if not undeclared:
            return {}
        configs = (one.load() for one in entry_points_by_name(CONFIGS).values())
        known = {parameter.name for config in configs for parameter in parameters_of(config)}
        return {
            name: value for name, value in sorted(undeclared.items()) if name not in known and not is_qos_override(name)
        }

    @property
    def names(self) -> list[str]:
        """Names of the parameters."""
        return list(self._fields)

    def converted(self, changes: list[RosParameter]) -> list[RosParameter]:
        """Check ``changes``, and convert integers and texts such as ``inf`` to floats for float parameters.

        Raises:
            DiffbotError: if a change is not allowed.
        """
        own = self._values(changes)
        # rclpy refuses any change of a read-only parameter.
        if not any(self._fields[name].spec.read_only for name in own):
            build(self._type, own, self.config)
        floats = {name for name in own if self._fields[name].type is float}
        return [
            RosParameter(one.name, RosParameter.Type.DOUBLE, checked(self._fields[one.name], one.value))
            if one.name in floats
            else one
            for one in changes
        ]

    def _apply(self, changes: list[RosParameter]) -> None:
        if own := self._values(changes):
            self.config = build(self._type, own, self.config)
            self._on_change(self.config)

    def _values(self, changes: list[RosParameter]) -> dict[str, Any]:
        """Return the values of the changes that concern fields of the configuration, with arrays as lists."""
        return {
            one.name: one.value.tolist() if isinstance(one.value, array) else one.value
            for one in changes
            if one.name in self._fields
        }


def descriptor_of(parameter: Parameter) -> ParameterDescriptor:
    """Return the ROS descriptor of a parameter.

    The descriptor of a parameter that allows ``inf`` is without a range, because rclpy would refuse ``inf`` then.
    """
    spec = parameter.spec
    descriptor = ParameterDescriptor(
        description=f"{spec.text} [{spec.unit}]",
        additional_constraints=spec.bound() if parameter.type in (float, int) or spec.choices else "",
        read_only=spec.read_only,
        # ROS does not know the element type of an empty list; schema.checked() checks the types.
        dynamic_typing=True,
    )
    closed = math.isfinite(spec.minimum) and math.isfinite(spec.maximum)
    if parameter.type is float and closed and not spec.allow_inf:
        descriptor.floating_point_range = [FloatingPointRange(from_value=spec.minimum, to_value=float(spec.maximum))]
    elif parameter.type is int and closed:
        descriptor.integer_range = [IntegerRange(from_value=int(spec.minimum), to_value=int(spec.maximum), step=1)]
    return descriptor
