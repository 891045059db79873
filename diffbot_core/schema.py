"""Configuration types, which define default, text, unit and range of each parameter in one place.

A configuration is a ``NamedTuple`` whose fields are annotated with a :class:`Spec`::

    @known_fields
    class Gains(NamedTuple):
        gamma: Annotated[float, Spec("bound of |v|", "m/s", minimum=1e-3, maximum=100.0)] = 1.3

ROS parameters (``ros.parameters``), YAML files, flags and the tables in docs/ are derived from it. A field whose type
is a configuration is a group. The parameters of a group have no prefix; ``Spec.parameter`` sets a name
that differs from the field's name, such as ``linear.x.max_velocity``.
"""

from __future__ import annotations

import functools
import math
import re
from collections import namedtuple
from collections.abc import Callable, Hashable, Iterable, Mapping
from types import MappingProxyType
from typing import Annotated, Any, NamedTuple, TypeVar, cast, get_args, get_origin, get_type_hints

from diffbot_core.errors import DiffbotError, InvalidValueError, known_name

C = TypeVar("C", bound=tuple[Any, ...])
PARTIAL = "fields of this group without a Spec are not parameters"
"""Annotation of a group that another package defines: ``Annotated[Group, PARTIAL]``."""
MAX_LENGTH = 4096
"""Longer lists and texts are refused."""
_NUMBER_AS_TEXT = re.compile(r"[+-]?(\d+(\.\d*)?e[+-]?\d+|\.?inf)", re.IGNORECASE)
"""Numbers that YAML 1.1 reads as texts: ``ros2 param load`` reads 1.0e-06 and .inf, but sends 1e-06 and inf."""

Range = tuple[float, float]
"""Minimum and maximum.

The ranges below are wide enough for any wheeled robot. They are narrow enough that no formula overflows in float64
for any combination of values: 1e308 squared and 1 / 5e-324 would be infinite.
"""

WHEEL_SIZE: Range = 1e-3, 10.0
"""[m] radius or distance of the wheels"""
LENGTH: Range = 1e-6, 1e6
"""[m] > 0"""
DISTANCE: Range = 0.0, 1e6
"""[m] >= 0"""
ANGLE: Range = 1e-6, 1e3
"""[rad] > 0; a tolerance of more than a turn accepts any heading"""
POSITION: Range = -1e6, 1e6
"""[m] coordinate of a pose"""
HEADING: Range = -1e3, 1e3
"""[rad] heading of a pose, not wrapped"""
SPEED: Range = 1e-6, 1e3
"""[m/s] > 0"""
TURN_RATE: Range = 1e-6, 1e3
"""[rad/s] > 0, of the body"""
WHEEL_SPEED: Range = 1e-6, 1e6
"""[rad/s] > 0, of a wheel"""
ACCELERATION: Range = 1e-6, 1e3
"""[m/s^2] > 0"""
ANGULAR_ACCELERATION: Range = 1e-6, 1e4
"""[rad/s^2] > 0, of the body"""
TIMEOUT: Range = 1e-3, 1e6
"""[s] > 0, up to eleven days"""
TIME: Range = 0.0, 1e6
"""[s] >= 0"""
GAIN: Range = 1e-6, 1e3
"""[1/s] or [-], > 0"""


class Spec(NamedTuple):
    """Description and allowed values of a field."""

    text: str
    """Meaning of the field."""
    unit: str = "-"
    """Physical unit, ``-`` for none."""
    minimum: float = -math.inf
    """Smallest allowed value."""
    maximum: float = math.inf
    """Largest allowed value."""
    allow_inf: bool = False
    """``inf`` is allowed and means no limit."""
    choices: tuple[str, ...] = ()
    """Allowed words of a text."""
    parameter: str = ""
    """Name of the ROS parameter, if it differs from the field's name."""
    read_only: bool = False
    """The parameter cannot be changed after the node has started."""

    def bound(self) -> str:
        """Describe the allowed values, for error messages and docs."""
        if self.choices:
            return "one of " + ", ".join(self.choices)
        low = "" if self.minimum == -math.inf else f">= {self.minimum:g}"
        high = "" if self.maximum == math.inf else f"<= {self.maximum:g}"
        words = " and ".join(part for part in (low, high) if part)
        if self.allow_inf:
            return f"{words} (inf: no limit)" if words else "a number (inf: no limit)"
        return words if words and self.maximum < math.inf else f"finite and {words}" if words else "finite"


class Parameter(NamedTuple):
    """One field of a configuration; see :func:`parameters_of`."""

    name: str
    """Name of the ROS parameter and YAML key."""
    path: tuple[str, ...]
    """Field names from the root of the configuration."""
    type: Any
    """float, int, bool, str, tuple[float, ...] or tuple[str, ...]"""
    default: Any
    spec: Spec


def known_fields(config_type: type[C]) -> type[C]:
    """Decorate a configuration type: an unknown field raises an InvalidValueError with similar names."""
    fields: tuple[str, ...] = config_type._fields  # type: ignore[attr-defined] # it is a NamedTuple

    def checking(method: Callable[..., Any]) -> Callable[..., Any]:
        @functools.wraps(method)
        def call(*args: Any, **values: Any) -> Any:
            for name in values.keys() - set(fields):
                raise InvalidValueError(name, values[name], known_name(name, fields))
            return method(*args, **values)

        return call

    for name in ("__new__", "_replace"):
        setattr(config_type, name, checking(getattr(config_type, name)))
    return config_type


def parameters_of(config_type: type[Any]) -> list[Parameter]:
    """Return the fields of a configuration type and of its groups in the order of definition.

    Fields without a Spec in a group that is annotated with PARTIAL are skipped.

    Raises:
        TypeError: if another field has no Spec, or two fields have the same parameter name.
    """
    return list(_parameters(cast(Hashable, config_type)))


@functools.cache  # resolving annotations takes milliseconds
def _parameters(config_type: Any) -> tuple[Parameter, ...]:
    found = _collect(config_type, config_type(), ())
    names = [parameter.name for parameter in found]
    twice = {name for name in names if names.count(name) > 1}
    if twice:
        raise TypeError(f"{config_type.__name__}: parameter names used twice: {sorted(twice)}")
    return tuple(found)


def variant(
    config_type: type[Any],
    groups: Mapping[str, Any],
    without: tuple[str, ...] = (),
    values: Mapping[str, Any] = MappingProxyType({}),
) -> type[Any]:
    """Return a modified copy of a configuration type.

    Args:
        config_type: the type to copy.
        groups: new annotations of fields by field name; the default of such a group is the default of its new type.
        without: names of the fields to remove.
        values: new defaults by parameter name.
    """
    hints = {**get_type_hints(config_type, include_extras=True), **groups}
    defaults = {**config_type()._asdict(), **{name: (get_args(hint) or (hint,))[0]() for name, hint in groups.items()}}
    names = [name for name in config_type._fields if name not in without]

    def with_defaults(found: Iterable[Any]) -> type[Any]:
        made = namedtuple(config_type.__name__, names, defaults=found)  # type: ignore[misc]
        made.__annotations__ = {name: hints[name] for name in names}
        return made

    made = with_defaults(defaults[name] for name in names)
    # A type of its own: parameters_of() keeps the defaults of a type.
    return with_defaults(build(made, values)) if values else made


def _collect(config_type: type[Any], default: Any, path: tuple[str, ...], partial: bool = False) -> list[Parameter]:
    found: list[Parameter] = []
    hints = get_type_hints(config_type, include_extras=True)
    for field in config_type._fields:
        hint = hints[field]
        here = (*path, field)
        value = getattr(default, field)
        kind, spec = get_args(hint)[:2] if get_origin(hint) is Annotated else (hint, None)
        if isinstance(spec, Spec):
            found.append(Parameter(spec.parameter or field, here, kind, value, spec))
        elif hasattr(kind, "_fields"):
            found.extend(_collect(kind, value, here, partial or spec == PARTIAL))
        elif not partial:
            raise TypeError(f"{config_type.__name__}.{field} has no Spec")
    return found


def build(config_type: type[C], values: Mapping[str, Any], base: C | None = None) -> C:
    """Build a configuration from values by parameter name; ``base`` or the defaults supply the other values.

    The ``check`` methods of the configuration and its groups check conditions between several fields.

    Raises:
        InvalidValueError: if a name is unknown, or a value has the wrong type or is not allowed.
    """
    parameters = {parameter.name: parameter for parameter in parameters_of(config_type)}
    config: Any = config_type() if base is None else base
    for name, value in values.items():
        if name not in parameters:
            raise InvalidValueError(name, value, known_name(name, parameters))
        parameter = parameters[name]
        config = _replace(config, parameter.path, checked(parameter, value))
    _check_groups(config)
    return config  # type: ignore[no-any-return]


def to_dict(config: tuple[Any, ...]) -> dict[str, Any]:
    """Return all values of a configuration by parameter name; the inverse of :func:`build`."""
    values = {}
    for parameter in parameters_of(type(config)):
        value: Any = config
        for field in parameter.path:
            value = getattr(value, field)
        values[parameter.name] = value
    return values


def checked(parameter: Parameter, value: Any) -> Any:
    """Check a value and return it in the parameter's type.

    Integers and the texts ``inf``, ``.inf`` and ``1e-06`` are converted to a float, because YAML files contain them.
    No other value is converted.

    Raises:
        InvalidValueError: if the type is wrong or the value is not allowed.
    """
    kind, spec, name = parameter.type, parameter.spec, parameter.name
    if hasattr(value, "__len__") and len(value) > MAX_LENGTH:
        raise InvalidValueError(name, value, sentence=f"its length {len(value)} must be <= {MAX_LENGTH}")
    if get_origin(kind) is tuple:
        if isinstance(value, (str, bytes)) or not hasattr(value, "__iter__"):
            raise InvalidValueError(name, value, "a list")
        item = parameter._replace(type=get_args(kind)[0])
        return tuple(checked(item, one) for one in value)
    if kind is float and isinstance(value, str) and _NUMBER_AS_TEXT.fullmatch(value):
        value = float(value.lower().replace(".inf", "inf"))
    if kind is float and isinstance(value, int) and not isinstance(value, bool):
        try:
            value = float(value)
        except OverflowError:
            raise InvalidValueError(name, value, spec.bound()) from None
    if not isinstance(value, kind) or (kind is int and isinstance(value, bool)):
        raise InvalidValueError(
            name,
            value,
            {float: "a number", int: "a whole number", bool: "true or false"}.get(kind, "a text"),
        )
    if kind in (float, int):
        _check_number(name, value, spec)
    elif spec.choices and value not in spec.choices:
        raise InvalidValueError(name, value, spec.bound())
    return value


def _check_number(name: str, value: float, spec: Spec) -> None:
    infinite_allowed = spec.allow_inf and value == math.inf
    # An int is finite, and may be too large to convert to a float.
    finite = isinstance(value, int) or math.isfinite(value)
    if not infinite_allowed and not (finite and spec.minimum <= value <= spec.maximum):
        raise InvalidValueError(name, value, spec.bound())


def _replace(config: Any, path: tuple[str, ...], value: Any) -> Any:
    head, *rest = path
    if rest:
        value = _replace(getattr(config, head), tuple(rest), value)
    return config._replace(**{head: value})


def _check_groups(config: Any) -> None:
    for field in config._fields:
        value = getattr(config, field)
        if hasattr(value, "_fields"):
            _check_groups(value)
    check = getattr(config, "check", None)
    if check is None:
        return
    try:
        check()
    except (ValueError, ArithmeticError) as error:  # raised by a configuration that another package defines
        raise DiffbotError(" ".join(f"{type(config).__name__}: {error}".split())) from error
