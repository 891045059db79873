"""ROS parameters from configuration types: declared, checked and kept in step with ``ros2 param set``."""

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
"""Names that rclpy declares when it creates a topic; a file for several nodes contains those of all nodes."""
CONFIGS = "diffbot.parameters"
"""Group of the entry points: name of the node -> ``package.module:Config``."""


def is_qos_override(name: str) -> bool:
    """Return True for a parameter that rclpy declares when a topic is created."""
    return _QOS_OVERRIDE.fullmatch(name) is not None


def overrides_of(node: Node) -> dict[str, Any]:
    """Return the values given to ``node`` from outside by name, also of parameters that are never declared."""
    # rclpy has no public way to list overrides that are never declared.
    given = getattr(node, "_parameter_overrides", {})
    return {name: parameter.value for name, parameter in given.items()}


class CheckedParameters(Generic[C]):
    """The parameters of one node as one configuration, which is always valid.

    A bad value at the start raises an error. A bad ``ros2 param set`` is refused with the same text.
    """

    def __init__(
        self,
        node: Node,
        config_type: type[C],
        on_change: Callable[[C], None],
        presets: Mapping[str, C] | None = None,
    ) -> None:
        """Declare every field of ``config_type`` on ``node``; ``on_change`` receives each later configuration.

        With ``presets`` the parameter ``preset`` selects the defaults of all other parameters.

        Raises:
            InvalidValueError: naming parameter, value and bound, if an override from outside is not allowed.
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
        """Declare a parameter and return its value: the override from outside if there is one."""
        value = self._overrides.get(parameter.name, default)
        if value is None and get_origin(parameter.type) is tuple:
            # rcl has no type for [], and gives such an override no value.
            value = ()
        value = checked(parameter, value)
        stored = list(value) if isinstance(value, tuple) else value
        self._node.declare_parameter(parameter.name, stored, descriptor_of(parameter), ignore_override=True)
        return value

    @property
    def unknown(self) -> dict[str, Any]:
        """Values given from outside under names that neither this node nor another node of this package has.

        The section /** of a file may hold parameters of all nodes.
        """
        left = {name: value for name, value in self._overrides.items() if not self._node.has_parameter(name)}
        if not left:
            return {}
        configs = (one.load() for one in entry_points_by_name(CONFIGS).values())
        known = {parameter.name for config in configs for parameter in parameters_of(config)}
        return {name: left[name] for name in sorted(left) if name not in known and not is_qos_override(name)}

    @property
    def names(self) -> list[str]:
        """Names of the parameters."""
        return list(self._fields)

    def converted(self, changes: list[RosParameter]) -> list[RosParameter]:
        """Return ``changes`` with whole numbers and the text ``inf`` converted to floats where a float is declared.

        Raises:
            DiffbotError: naming parameter, value and bound, if a change is not allowed.
        """
        ours = self._values(changes)
        # rclpy refuses a change of a read-only parameter, whatever its value.
        if not any(self._fields[name].spec.read_only for name in ours):
            build(self._type, ours, self.config)
        floats = {name for name in ours if self._fields[name].type is float}
        return [
            RosParameter(one.name, RosParameter.Type.DOUBLE, checked(self._fields[one.name], one.value))
            if one.name in floats
            else one
            for one in changes
        ]

    def _apply(self, changes: list[RosParameter]) -> None:
        if ours := self._values(changes):
            self.config = build(self._type, ours, self.config)
            self._on_change(self.config)

    def _values(self, changes: list[RosParameter]) -> dict[str, Any]:
        """Return the values of declared fields, arrays as lists."""
        return {
            one.name: one.value.tolist() if isinstance(one.value, array) else one.value
            for one in changes
            if one.name in self._fields
        }


def descriptor_of(parameter: Parameter) -> ParameterDescriptor:
    """Return text, unit and bounds of a parameter, and a range unless ``inf`` is allowed.

    rclpy enforces a range, and a range cannot express that inf is allowed beyond its bound.
    """
    spec = parameter.spec
    descriptor = ParameterDescriptor(
        description=f"{spec.text} [{spec.unit}]",
        additional_constraints=spec.bound() if parameter.type in (float, int) or spec.choices else "",
        read_only=spec.read_only,
        # ROS cannot know the element type of an empty list; schema.checked() checks the types.
        dynamic_typing=True,
    )
    closed = math.isfinite(spec.minimum) and math.isfinite(spec.maximum)
    if parameter.type is float and closed and not spec.allow_inf:
        descriptor.floating_point_range = [FloatingPointRange(from_value=spec.minimum, to_value=float(spec.maximum))]
    elif parameter.type is int and closed:
        descriptor.integer_range = [IntegerRange(from_value=int(spec.minimum), to_value=int(spec.maximum), step=1)]
    return descriptor
