"""Arguments of the command line: types for argparse, and flags for the fields of a configuration."""

from __future__ import annotations

import argparse
import json
import math
from collections.abc import Callable, Collection, Mapping
from pathlib import Path
from typing import Any, TypeVar, get_args

from diffbot_core.errors import DiffbotError, InvalidValueError, shown
from diffbot_core.files import check_output, expanded
from diffbot_core.schema import parameters_of
from diffbot_core.yaml_files import load_yaml

MAX_SEED = 2**63 - 1
MAX_HEADING = math.tau
"""[rad] largest heading of a goal; a larger number is probably in degrees"""
OUTPUTS = ("out", "record")
"""Options whose paths are written, in every command. The paths of all other options are read."""
Number = TypeVar("Number", int, float)


def check_paths(options: argparse.Namespace) -> None:
    """Expand ``~`` in all paths, and refuse to overwrite a bag, an input or a file that diffbot did not write.

    Raises:
        DiffbotError: if :func:`~diffbot_core.files.check_output` refuses a path, or the user after ``~`` is unknown.
    """
    inputs, outputs = list[Path](), list[Path]()
    for name, value in vars(options).items():
        given = value if isinstance(value, list) else [value]
        paths = [expanded(one) for one in given if isinstance(one, Path)]  # the shell does not expand --out=~/file
        if paths:
            setattr(options, name, paths if isinstance(value, list) else paths[0])
            (outputs if name in OUTPUTS else inputs).extend(paths)
    for path in outputs:
        check_output(path, inputs)


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

    checked.__name__ = name  # argparse shows it if the text is not a number
    return checked


def duration(text: str) -> float:
    """Return a positive time [s], which may be infinite; a type for argparse."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not value > 0.0:
        raise argparse.ArgumentTypeError(f"{text!r}: must be a time > 0 [s]")
    return value


def checked_heading(name: str, theta: float, degrees: str = "math.radians({:g})") -> float:
    """Return the heading ``theta`` of a goal [rad] if it is within a turn.

    Args:
        name: name of the heading in the error.
        theta: [rad].
        degrees: syntax for an angle in degrees in the error, with a placeholder for the number.

    Raises:
        InvalidValueError: if the heading is not finite, or exceeds a turn.
    """
    if not abs(theta) <= MAX_HEADING:
        bound = f"a heading within a turn, +-{MAX_HEADING:.2f} rad; for degrees write {degrees.format(theta)}"
        raise InvalidValueError(name, theta, bound)
    return theta


def angle(text: str) -> float:
    """Return a heading [rad] that is given in radians, or in degrees as ``90deg``; a type for argparse."""
    number, is_degrees, rest = text.partition("deg")
    try:
        if rest:
            raise ValueError
        value = float(number)
        if is_degrees and not abs(value) <= 360.0:
            raise argparse.ArgumentTypeError(f"{text!r}: must be a heading within a turn, +-360deg")
        return checked_heading("yaw", math.radians(value) if is_degrees else value, "{:g}deg")
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r}: must be a heading [rad], or in degrees as 90deg") from None
    except InvalidValueError as error:
        raise argparse.ArgumentTypeError(str(error)) from None


def yaml_value(text: str) -> Any:
    """Parse a text as YAML and return its value; a type for argparse."""
    try:
        return load_yaml(text, shown(text), unique_keys=True)
    except DiffbotError as error:
        raise argparse.ArgumentTypeError(str(error)) from None


def setting(text: str) -> tuple[str, Any]:
    """Return the name and the value of NAME=VALUE; a type for argparse."""
    name, found, value = text.partition("=")
    if not found or not name:
        raise argparse.ArgumentTypeError(f"{text!r}: must be NAME=VALUE")
    return name, yaml_value(value)


def ros_parameters(values: Mapping[str, Any]) -> list[str]:
    """Return the ROS arguments that set these parameters."""
    # ROS parses values as YAML. JSON is valid YAML, except for escaped surrogate pairs. Therefore ensure_ascii is off.
    pairs = (f"{name}:={json.dumps(value, ensure_ascii=False)}" for name, value in values.items())
    return [part for pair in pairs for part in ("-p", pair)]


def once(flag: str, settings: list[tuple[str, Any]]) -> dict[str, Any]:
    """Return the values of ``settings`` by name.

    Args:
        flag: option that has given the settings, for the error.
        settings: name and value of each.

    Raises:
        InvalidValueError: if a name appears twice.
    """
    values: dict[str, Any] = {}
    for name, value in settings:
        if name in values:
            raise InvalidValueError(f"{flag} {name}", value, "given once")
        values[name] = value
    return values


def add_remap(parser: argparse.ArgumentParser, names: Callable[[], Collection[str]] | None, text: str) -> None:
    """Add the option --remap NAME:=TOPIC.

    Args:
        parser: parser of the command.
        names: returns the allowed names; it is called if the option is given. None: the command checks the names.
        text: help of the option.
    """

    def remapping(word: str) -> tuple[str, str]:
        (name, found, topic), known = word.partition(":="), names() if names else ()
        if not found or not topic or (known and name.lstrip("/") not in known):
            one_of = f" with NAME one of {', '.join(known)}" if known else ""
            raise argparse.ArgumentTypeError(f"{word!r}: must be NAME:=TOPIC{one_of}")
        return name.lstrip("/"), topic

    parser.add_argument("--remap", type=remapping, nargs="+", default=[], metavar="NAME:=TOPIC", help=text)


def add_flags(parser: argparse.ArgumentParser, config_type: type[Any], without: tuple[str, ...] = ()) -> None:
    """Add a flag for each parameter of a configuration; the parsed options contain only flags that were given."""
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
