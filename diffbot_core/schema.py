"""Configuration types: defaults, texts, units and ranges are written once, beside each field.

A configuration is a ``NamedTuple`` whose fields are annotated with a :class:`Spec`::

    @known_fields
    class Gains(NamedTuple):
        gamma: Annotated[float, Spec("bound of |v|", "m/s", minimum=1e-3, maximum=100.0)] = 1.3

ROS parameters (``ros.parameters``), YAML files, flags and the tables in docs/ derive from it. A field whose type is
again a configuration is a group; its fields stand on the same level, since ROS parameter names are flat unless
``Spec.parameter`` says otherwise (``linear.x.max_velocity``).

A choice between words that compiled code has to read is an ``int`` field with ``choices``: the configuration holds the
index of the word, everybody outside reads and writes the word::

    kind: Annotated[int, Spec("how the radius is set", choices=("fixed", "covariance"))] = 1
"""

from __future__ import annotations

import functools
import math
import re
from collections import namedtuple
from collections.abc import Callable, Hashable, Mapping
from types import MappingProxyType
from typing import Annotated, Any, NamedTuple, TypeVar, cast, get_args, get_origin, get_type_hints

from diffbot_core.errors import DiffbotError, InvalidValueError, known_name

C = TypeVar("C", bound=tuple[Any, ...])
PARTIAL = "fields of this group without a Spec are no parameters"
"""Annotation of a group whose type is not this project's: ``Annotated[Group, PARTIAL]``."""
MAX_LENGTH = 4096
"""of a list, and of a text [characters]: what is longer is refused before anything of it is looked at"""
_NUMBER_AS_TEXT = re.compile(r"[+-]?(\d+(\.\d*)?e[+-]?\d+|\.?inf)", re.IGNORECASE)
"""Numbers that YAML 1.1 reads as texts: ``ros2 param load`` sends 1.0e-06 and .inf of a file as 1e-06 and inf."""


Range = tuple[float, float]
"""Minimum and maximum.

The ranges below, which several parameters share, are wide enough for any wheeled robot, and so narrow that every
formula stays finite in float64 whatever values are combined. A bound such as "finite and > 0" would not do: 1e308
squared is infinite, and so is 1 / 5e-324.
"""

WHEEL_SIZE: Range = 1e-3, 10.0
"""[m] radius of a wheel, distance of the wheels"""
LENGTH: Range = 1e-6, 1e6
"""[m] that must not be zero"""
DISTANCE: Range = 0.0, 1e6
"""[m] that may be zero"""
ANGLE: Range = 1e-6, 1e3
"""[rad] that must not be zero; larger than a turn: any heading will do"""
POSITION: Range = -1e6, 1e6
"""[m] coordinate of a pose"""
HEADING: Range = -1e3, 1e3
"""[rad] of a pose, not wrapped"""
SPEED: Range = 1e-6, 1e3
"""[m/s] that must not be zero"""
TURN_RATE: Range = 1e-6, 1e3
"""[rad/s] of the body, that must not be zero"""
WHEEL_SPEED: Range = 1e-6, 1e6
"""[rad/s] of a wheel: SPEED on the smallest one"""
ACCELERATION: Range = 1e-6, 1e3
"""[m/s^2]"""
ANGULAR_ACCELERATION: Range = 1e-6, 1e4
"""[rad/s^2] of the body"""
TIMEOUT: Range = 1e-3, 1e6
"""[s] that must not be zero; the longest are eleven days"""
TIME: Range = 0.0, 1e6
"""[s] that may be zero"""
GAIN: Range = 1e-6, 1e3
"""[1/s] or [-], that must not be zero"""
SIGMAS: Range = 0.0, 1e3
"""[-] number of standard deviations"""
SHARE: Range = 1e-3, 1.0
"""[-] that must not be zero"""


class Spec(NamedTuple):
    """What a field means and which values it takes."""

    text: str
    """Meaning, half a sentence."""
    unit: str = "-"
    """Physical unit, ``-`` for none."""
    minimum: float = -math.inf
    """Smallest value allowed."""
    maximum: float = math.inf
    """Largest value allowed."""
    allow_inf: bool = False
    """``inf`` is allowed and means: no limit."""
    choices: tuple[str, ...] = ()
    """The words allowed, for a text; for an ``int`` field, the words whose index it holds."""
    parameter: str = ""
    """Name as a ROS parameter, where it differs from the field's."""
    read_only: bool = False
    """Read when the node starts; a later change is refused."""

    def bound(self) -> str:
        """Describe the allowed values, as error messages and the docs show them."""
        if self.choices:
            return "one of " + ", ".join(self.choices)
        low = "" if self.minimum == -math.inf else f">= {self.minimum:g}"
        high = "" if self.maximum == math.inf else f"<= {self.maximum:g}"
        words = " and ".join(part for part in (low, high) if part)
        if self.allow_inf:
            return f"{words} (inf: no limit)" if words else "a number (inf: no limit)"
        return words if words and self.maximum < math.inf else f"finite and {words}" if words else "finite"


class Parameter(NamedTuple):
    """One field of a configuration, found by :func:`parameters_of`."""

    name: str
    """Its name outside: ROS parameter, YAML key."""
    path: tuple[str, ...]
    """Field names from the root of the configuration."""
    type: Any
    """float, int, bool, str, tuple[float, ...] or tuple[str, ...]; str for a choice of words, coded or not."""
    default: Any
    spec: Spec
    coded: bool = False
    """The configuration holds the index of the word in ``spec.choices``."""

    def encode(self, value: Any) -> Any:
        """Return what the configuration holds for ``value`` as it is named outside; the inverse of :meth:`decode`."""
        return self.spec.choices.index(value) if self.coded else value

    def decode(self, value: Any) -> Any:
        """Return the outside form of what the configuration holds."""
        return self.spec.choices[value] if self.coded else value


def known_fields(config_type: type[C]) -> type[C]:
    """Make a configuration type name its fields, in one line, when it is given one that it does not have."""
    fields = config_type._fields  # type: ignore[attr-defined] # it is a NamedTuple
    for method in ("__new__", "_replace"):
        setattr(config_type, method, _with_known_fields(getattr(config_type, method), fields))
    return config_type


def _with_known_fields(method: Callable[..., Any], fields: tuple[str, ...]) -> Callable[..., Any]:
    @functools.wraps(method)
    def wrapped(*args: Any, **values: Any) -> Any:
        for name in values.keys() - set(fields):
            raise InvalidValueError(name, values[name], known_name(name, fields))
        return method(*args, **values)

    return wrapped


def parameters_of(config_type: type[Any]) -> list[Parameter]:
    """List the fields of a configuration type, groups unfolded, in the order of definition.

    In a group marked as PARTIAL, fields without a Spec are left out.

    Raises:
        TypeError: if a field carries no Spec or two fields share a name (a programming error).
    """
    return list(_parameters(cast(Hashable, config_type)))


@functools.cache  # resolving annotations takes milliseconds
def _parameters(config_type: Any) -> tuple[Parameter, ...]:
    found = _unfold(config_type, config_type(), ())
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
    """Return a configuration type like another one.

    Args:
        config_type: the other one.
        groups: annotation of each group that has another type, by the name of its field.
        without: names of fields to leave out.
        values: other defaults, by the names of the parameters.
    """
    hints = {**get_type_hints(config_type, include_extras=True), **groups}
    defaults = {**config_type()._asdict(), **{name: (get_args(hint) or (hint,))[0]() for name, hint in groups.items()}}
    names = [name for name in config_type._fields if name not in without]
    made = namedtuple(config_type.__name__, names, defaults=[defaults[name] for name in names])  # type: ignore[misc]
    made.__annotations__ = {name: hints[name] for name in names}
    if values:
        made.__new__.__defaults__ = tuple(build(made, values))
    return made


def _unfold(config_type: type[Any], default: Any, path: tuple[str, ...], partial: bool = False) -> list[Parameter]:
    found: list[Parameter] = []
    hints = get_type_hints(config_type, include_extras=True)
    for field in config_type._fields:
        hint = hints[field]
        here = (*path, field)
        value = getattr(default, field)
        kind, spec = get_args(hint)[:2] if get_origin(hint) is Annotated else (hint, None)
        if isinstance(spec, Spec):
            coded = kind is int and bool(spec.choices)
            parameter = Parameter(spec.parameter or field, here, str if coded else kind, value, spec, coded)
            found.append(parameter._replace(default=parameter.decode(value)))
        elif hasattr(kind, "_fields"):
            found.extend(_unfold(kind, value, here, partial or spec == PARTIAL))
        elif not partial:
            raise TypeError(f"{config_type.__name__}.{field} has no Spec")
    return found


def build(config_type: type[C], values: Mapping[str, Any], base: C | None = None) -> C:
    """Make a valid configuration from named values; ``base`` (by default the defaults) supplies the rest.

    When all fields are set, the ``check`` method of each group that has one checks what must hold between fields.

    Raises:
        InvalidValueError: for an unknown name, a wrong type, a number out of range or not finite.
    """
    parameters = {parameter.name: parameter for parameter in parameters_of(config_type)}
    config: Any = config_type() if base is None else base
    for name, value in values.items():
        if name not in parameters:
            raise InvalidValueError(name, value, known_name(name, parameters))
        parameter = parameters[name]
        config = _replace(config, parameter.path, parameter.encode(checked(parameter, value)))
    _check_groups(config)
    return config  # type: ignore[no-any-return]


def to_dict(config: tuple[Any, ...]) -> dict[str, Any]:
    """Return all values of a configuration under their outside names; the inverse of :func:`build`."""
    values = {}
    for parameter in parameters_of(type(config)):
        value: Any = config
        for field in parameter.path:
            value = getattr(value, field)
        values[parameter.name] = parameter.decode(value)
    return values


def checked(parameter: Parameter, value: Any) -> Any:
    """Return ``value`` as the parameter's type if it is allowed.

    For a float a whole number is accepted, since YAML writes ``2`` for 2.0, and the texts ``inf``, ``.inf`` and
    ``1e-06``; nothing else is converted.

    Raises:
        InvalidValueError: naming the parameter, the value and the bound.
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
    except (ValueError, ArithmeticError) as error:  # of a configuration that is not this project's
        raise DiffbotError(" ".join(f"{type(config).__name__}: {error}".split())) from error
