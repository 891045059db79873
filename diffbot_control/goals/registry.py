"""Laws by name: registered ones by the entry points ``diffbot.controllers``, others by ``package.module:Class``."""

from __future__ import annotations

import importlib
import inspect
from typing import Any, cast

from diffbot_control.goals.protocol import Law
from diffbot_core.distribution import entry_points_by_name
from diffbot_core.errors import InvalidValueError

GROUP = "diffbot.controllers"
"""Group of the entry points: name of the law -> ``package.module:Class``."""
_PARAMETERS = {"new_memory": 1, "step": 5}
"""Functions of a law and how many arguments they are called with."""


def registered_laws() -> dict[str, str]:
    """Return the names of all registered laws and where each is, ``package.module:Class``, sorted by name."""
    return {name: one.value for name, one in entry_points_by_name(GROUP).items()}


def resolve_law(text: str) -> Law:
    """Return the law of a registered name or of ``package.module:Class``.

    Raises:
        InvalidValueError: in one line, if there is none, it cannot be imported, or it lacks a part of the protocol.
    """
    found = registered_laws()
    place = found.get(text, text)
    module_name, colon, attribute = place.partition(":")
    if not (colon and module_name and attribute):
        raise InvalidValueError("law", text, f"package.module:Class or one of {', '.join(found) or 'none registered'}")
    try:
        law: Any = importlib.import_module(module_name)
        for part in attribute.split("."):
            law = getattr(law, part)
    except (Exception, SystemExit) as error:  # a module may end the interpreter when it is imported
        cause = " ".join(f"{type(error).__name__}: {error}".split())
        raise InvalidValueError("law", text, f"importable ({cause})") from None
    _check(text, law)
    return cast(Law, law)


def _check(text: str, law: Any) -> None:
    """Refuse what lacks a part of the protocol.

    Raises:
        InvalidValueError: naming the first part that is missing or unfit.
    """
    if not isinstance(getattr(law, "name", None), str) or not law.name:
        raise InvalidValueError("law", text, "a law with a text 'name'")
    config_type = getattr(law, "Config", None)
    if not (isinstance(config_type, type) and hasattr(config_type, "_fields")):
        raise InvalidValueError("law", text, "a law with a NamedTuple type 'Config'")
    for part, number in _PARAMETERS.items():
        function = getattr(law, part, None)
        try:
            inspect.signature(function).bind(*range(number))  # type: ignore[arg-type]
        except (TypeError, ValueError):
            raise InvalidValueError("law", text, f"a law whose '{part}' takes {number} arguments") from None
    try:
        memory = law.new_memory(config_type())
    except Exception as error:
        cause = " ".join(f"{type(error).__name__}: {error}".split())
        raise InvalidValueError("law", text, f"a law that starts with its defaults ({cause})") from None
    if not hasattr(memory, "reached"):
        raise InvalidValueError("law", text, "a law whose memory has a field 'reached'")
