"""Arguments of the command line: their types, and flags of a configuration."""

from __future__ import annotations

import argparse
import json
import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, TypeVar, get_args

from diffbot_core.errors import DiffbotError, InvalidValueError, shown
from diffbot_core.files import check_output
from diffbot_core.schema import parameters_of
from diffbot_core.yaml_files import load_yaml

MAX_SEED = 2**63 - 1
MAX_HEADING = math.tau
"""[rad] of a goal; a larger one is probably meant in degrees"""
OUTPUTS = ("out", "record")
"""Names of the options, of any command, with a path to write to; all other paths are read."""
Number = TypeVar("Number", int, float)


def check_outputs(options: argparse.Namespace) -> None:
    """Refuse outputs of any command that would destroy a bag, an input or a file of another kind.

    Raises:
        DiffbotError: see files.check_output.
    """
    given = {name: value if isinstance(value, list) else [value] for name, value in vars(options).items()}
    inputs = [one for name, values in given.items() if name not in OUTPUTS for one in values if isinstance(one, Path)]
    for name in OUTPUTS:
        for path in given.get(name, ()):
            if isinstance(path, Path):
                check_output(path.expanduser(), [one.expanduser() for one in inputs])


def whole(low: int, high: int) -> Callable[[str], int]:
    """Return a type for argparse: a whole number from ``low`` to ``high``."""
    return _between(int, "whole number", low, high)


def number_between(low: float, high: float) -> Callable[[str], float]:
    """Return a type for argparse: a number from ``low`` to ``high``."""
    return _between(float, "number", low, high)


def _between(kind: Callable[[str], Number], name: str, low: Number, high: Number) -> Callable[[str], Number]:
    def checked(text: str) -> Number:
        value = kind(text)
        if not low <= value <= high:
            bounds = (f"{bound:g}" if isinstance(bound, float) else str(bound) for bound in (low, high))
            raise argparse.ArgumentTypeError(f"{text}: must be from {' to '.join(bounds)}")
        return value

    checked.__name__ = name  # of argparse's message
    return checked


def duration(text: str) -> float:
    """Return a time > 0 [s], which may be infinite; a type for argparse."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not value > 0.0:
        raise argparse.ArgumentTypeError(f"{text!r}: must be a time > 0 [s]")
    return value


def checked_heading(name: str, theta: float, degrees: str = "math.radians({:g})") -> float:
    """Return the heading of a goal [rad]; ``degrees`` is the form in which an angle can be given in degrees.

    Raises:
        InvalidValueError: if it is not finite, or more than a turn, which is probably meant in degrees.
    """
    if not abs(theta) <= MAX_HEADING:
        hint = f"within a turn, +-{MAX_HEADING:.2f} rad; for degrees write {degrees.format(theta)}"
        raise InvalidValueError(name, theta, f"a heading {hint}")
    return theta


def angle(text: str) -> float:
    """Return a heading [rad] of a number, or of a number of degrees as ``90deg``; a type for argparse."""
    number, is_degrees, rest = text.partition("deg")
    try:
        if rest:
            raise ValueError
        value = float(number)
        return checked_heading("yaw", math.radians(value) if is_degrees else value, "{:g}deg")
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r}: must be a heading [rad], or in degrees as 90deg") from None
    except InvalidValueError as error:
        raise argparse.ArgumentTypeError(str(error)) from None


def yaml_value(text: str) -> Any:
    """Return a YAML document of plain values; a type for argparse."""
    try:
        return load_yaml(text, shown(text), unique_keys=True)
    except DiffbotError as error:
        raise argparse.ArgumentTypeError(str(error)) from None


def setting(text: str) -> tuple[str, Any]:
    """Return name and value of NAME=VALUE; a type for argparse."""
    name, found, value = text.partition("=")
    if not found or not name:
        raise argparse.ArgumentTypeError(f"{text!r}: must be NAME=VALUE")
    return name, yaml_value(value)


def ros_parameters(values: Mapping[str, Any]) -> list[str]:
    """Return the ROS arguments that set parameters."""
    # ROS parses values as YAML, of which JSON is a subset, but not its pairs of surrogates.
    pairs = (f"{name}:={json.dumps(value, ensure_ascii=False)}" for name, value in values.items())
    return [part for pair in pairs for part in ("-p", pair)]


def once(flag: str, settings: list[tuple[str, Any]]) -> dict[str, Any]:
    """Return settings by name.

    Raises:
        InvalidValueError: if a name is given twice.
    """
    values: dict[str, Any] = {}
    for name, value in settings:
        if name in values:
            raise InvalidValueError(f"{flag} {name}", value, "given once")
        values[name] = value
    return values


def add_flags(parser: argparse.ArgumentParser, config_type: type[Any], without: tuple[str, ...] = ()) -> None:
    """Add a flag for each parameter of a configuration; flags that are not given are absent from the result."""
    for parameter in parameters_of(config_type):
        if parameter.name in without:
            continue
        default = " ".join(map(str, parameter.default)) if isinstance(parameter.default, tuple) else parameter.default
        unit = "" if parameter.spec.unit == "-" else f" [{parameter.spec.unit}]"
        options: dict[str, Any] = {
            "help": f"{parameter.spec.text}{unit}".replace("%", "%%")
            + (f" (default: {default})" if default not in ("", False) else ""),
            "default": argparse.SUPPRESS,
        }
        if parameter.type is bool:
            options["action"] = "store_true"
        elif parameter.type in (float, int):
            options["type"] = parameter.type
        elif parameter.type is not str:
            options |= {"nargs": "+", "type": get_args(parameter.type)[0]}
        parser.add_argument("--" + parameter.name.replace("_", "-").replace(".", "-"), dest=parameter.name, **options)
