"""ROS parameters from configuration types: declared, checked and kept in step with ``ros2 param set``."""

from __future__ import annotations

import math
import re
from array import array
from collections.abc import Callable, Mapping
from difflib import get_close_matches
from typing import Any, Generic, get_origin

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.node import Node
from rclpy.parameter import Parameter as RosParameter

from diffbot_core.distribution import entry_points_by_name
from diffbot_core.foreign_files import shown
from diffbot_core.schema import C, Parameter, build, checked, parameters_of, refuse_replaced, to_dict

_QOS_OVERRIDE = re.compile(r"qos_overrides\./.+\.(publisher|subscription)(_\w+)?\.[a-z_]+")
"""Names that rclpy declares when the topic is created; a file for several nodes holds those of all."""
_MAX_WARNINGS = 10
"""of unknown parameters"""
CONFIGS = "diffbot.parameters"
"""Group of the entry points: name of the node -> ``package.module:Config``."""


def overrides_of(node: Node) -> dict[str, Any]:
    """Return the values given to ``node`` from outside, declared or not, by name."""
    # rclpy ignores an override that is never declared and has no public way to list them.
    given = getattr(node, "_parameter_overrides", {})
    return {name: parameter.value for name, parameter in given.items()}


def names_of_all_nodes() -> set[str]:
    """Return the names of the parameters of all nodes, which the section ``/**`` of a file may hold."""
    configs = (one.load() for one in entry_points_by_name(CONFIGS).values())
    return {parameter.name for config in configs for parameter in parameters_of(config)}


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
        self._overrides = overrides_of(node)
        refuse_replaced(config_type, self._overrides)
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
        self._warn_of_unknown_overrides()
        node.add_post_set_parameters_callback(self._apply)

    def _declare(self, parameter: Parameter, default: Any) -> Any:
        """Declare a parameter and return its value: the override from outside if there is one."""
        value = self._overrides.get(parameter.name, default)
        if value is None and get_origin(parameter.type) is tuple:
            # rcl knows no type for [] and gives the override no value.
            value = ()
        value = checked(parameter, value)
        stored = list(value) if isinstance(value, tuple) else value
        self._node.declare_parameter(parameter.name, stored, descriptor_of(parameter), ignore_override=True)
        return value

    def _warn_of_unknown_overrides(self) -> None:
        unknown = [name for name in sorted(self._overrides) if not self._node.has_parameter(name)]
        if not unknown:
            return
        known = names_of_all_nodes()
        strange = [name for name in unknown if name not in known and not _QOS_OVERRIDE.fullmatch(name)]
        for name in strange[:_MAX_WARNINGS]:
            similar = get_close_matches(name, [*self._fields, *known], 1)
            meant = f"; did you mean '{similar[0]}'?" if similar else ""
            self._node.get_logger().warning(f"unknown parameter {shown(name)!r} is ignored{meant}")
        if more := len(strange[_MAX_WARNINGS:]):
            self._node.get_logger().warning(f"{more} more unknown parameters are ignored")

    def converted(self, changes: list[RosParameter]) -> list[RosParameter]:
        """Return ``changes`` with whole numbers and the text ``inf`` as the floats that they stand for.

        Raises:
            DiffbotError: naming parameter, value and bound, if a change is not allowed.
        """
        ours = {change.name: _plain(change.value) for change in changes if change.name in self._fields}
        # A read-only one is refused as such by rclpy, whatever its value.
        if not any(self._fields[name].spec.read_only for name in ours):
            build(self._type, ours, self.config)
        result = []
        for change in changes:
            parameter = self._fields.get(change.name)
            if parameter is not None and parameter.type is float:
                value = checked(parameter, change.value)
                result.append(RosParameter(change.name, RosParameter.Type.DOUBLE, value))
            else:
                result.append(change)
        return result

    def _apply(self, changes: list[RosParameter]) -> None:
        ours = {change.name: _plain(change.value) for change in changes if change.name in self._fields}
        if ours:
            self.config = build(self._type, ours, self.config)
            self._on_change(self.config)


def descriptor_of(parameter: Parameter) -> ParameterDescriptor:
    """Return text, unit and bounds of a parameter, and a range unless ``inf`` is allowed.

    rclpy enforces a range by itself, and ROS has no words for inf beyond it.
    """
    spec = parameter.spec
    descriptor = ParameterDescriptor(
        description=f"{spec.text} [{spec.unit}]",
        additional_constraints=spec.bound() if parameter.type in (float, int) or spec.choices else "",
        read_only=spec.read_only,
        # The element type of an empty list is unknown; schema.checked() checks the types.
        dynamic_typing=True,
    )
    closed = math.isfinite(spec.minimum) and math.isfinite(spec.maximum)
    if parameter.type is float and closed and not spec.allow_inf:
        descriptor.floating_point_range = [FloatingPointRange(from_value=spec.minimum, to_value=float(spec.maximum))]
    elif parameter.type is int and closed:
        descriptor.integer_range = [IntegerRange(from_value=int(spec.minimum), to_value=int(spec.maximum), step=1)]
    return descriptor


def _plain(value: Any) -> Any:
    """Return a list for an array, as rclpy gives lists later: it prints differently from the list at the start."""
    return value.tolist() if isinstance(value, array) else value
