"""Laws by name, and presets: named sets of defaults, each for one law."""

from __future__ import annotations

import importlib
from typing import Any, NamedTuple

from diffbot_control.law.configuration import PaperConfig, SwitchingConfig
from diffbot_control.law.goal_checker import GoalTolerance
from diffbot_control.law.law import Law
from diffbot_control.law.paper import PaperLaw
from diffbot_control.law.switching import SwitchingLaw
from diffbot_core.data_sheet import DataSheet
from diffbot_core.errors import InvalidValueError
from diffbot_core.installed import entry_points_by_name

GROUP = "diffbot.controllers"
"""Group of the entry points: name of the law -> ``package.module:Class``."""


class Preset(NamedTuple):
    """A law with its parameters."""

    law: type[Law]
    config: Any
    """instance of the law's Config"""


TUNED, PRECISE, PAPER = "tuned", "precise", "paper"
PRESETS = {
    TUNED: Preset(SwitchingLaw, SwitchingConfig()),
    PRECISE: Preset(SwitchingLaw, SwitchingConfig(tolerance=GoalTolerance(xy_goal_tolerance=0.03))),
    PAPER: Preset(PaperLaw, PaperConfig()),
}
"""``tuned``: the defaults. ``precise``: the defaults with a position tolerance of 0.03 m. ``paper``: the law of the
paper, with its gains and its fixed region."""


def registered_laws() -> dict[str, str]:
    """Return ``package.module:Class`` of all registered laws by name, sorted by name."""
    return {name: one.value for name, one in entry_points_by_name(GROUP).items()}


def resolve_law(text: str) -> type[Law]:
    """Return a law; import it unless it is the law of a preset.

    Args:
        text: registered name, or ``package.module:Class``.

    Raises:
        InvalidValueError: if the law does not exist, or cannot be imported or used.
    """
    for preset in PRESETS.values():
        if text == preset.law.name:
            return preset.law  # without reading the entry points of all installed packages, which is slow
    laws = registered_laws()
    module_name, colon, attribute = laws.get(text, text).partition(":")
    if not (colon and module_name and attribute):
        raise InvalidValueError("law", text, f"package.module:Class or a registered law: {', '.join(laws) or 'none'}")
    try:
        law: Any = importlib.import_module(module_name)
        for part in attribute.split("."):
            law = getattr(law, part)
    except (Exception, SystemExit) as error:  # a module may call sys.exit when it is imported
        raise InvalidValueError("law", text, f"a law that can be imported ({_cause(error)})") from None
    return _checked(text, law)


def _checked(text: str, law: Any) -> type[Law]:
    """Return ``law`` if it can be used with its default parameters.

    Raises:
        InvalidValueError: naming the first attribute that is missing or wrong.
    """
    if not (isinstance(law, type) and issubclass(law, Law)):
        raise InvalidValueError("law", text, "a class derived from diffbot_control.law.Law")
    config_type = vars(law).get("Config")
    if not (isinstance(config_type, type) and hasattr(config_type, "_fields")):
        raise InvalidValueError("law", text, "a law whose Config is a NamedTuple type")
    if not isinstance(vars(law).get("name"), str) or not law.name:
        raise InvalidValueError("law", text, "a law whose name is a string that is not empty")
    try:
        config = config_type()
        memory = law.new_memory(config)
        is_complete = isinstance(law.data_sheet(config), DataSheet) and law.tolerance(config).settling_steps > 0
    except Exception as error:
        raise InvalidValueError("law", text, f"a law that can be used with its defaults ({_cause(error)})") from None
    if not is_complete:
        raise InvalidValueError(
            "law", text, "a law whose data_sheet(config) is a DataSheet and whose tolerance(config) is valid"
        )
    if not hasattr(memory, "reached"):
        raise InvalidValueError("law", text, "a law whose memory has the field reached")
    return law


def _cause(error: BaseException) -> str:
    return " ".join(f"{type(error).__name__}: {error}".split())
