"""Write the reference of the Python interface as Markdown, from signatures and Google-style docstrings."""

from __future__ import annotations

import inspect
import re
from collections.abc import Iterator
from importlib import import_module
from typing import Any

ENTRIES = {
    "diffbot.drive": "diffbot.simulation:drive",
    "diffbot.Recording": "diffbot.simulation:Recording",
    "diffbot.Simulation": "diffbot.simulation:Simulation",
    "diffbot.robot": "diffbot.arguments:robot",
    "diffbot.Controller": "diffbot.loop:Controller",
    "diffbot.Filter": "diffbot.loop:Filter",
    "diffbot.Navigator": "diffbot_control.ros.navigator:Navigator",
    "diffbot.Bag": "diffbot_bag.bag:BagReader",
    "diffbot_control.law.step": "diffbot_control.law.switching:step",
    "diffbot_control.law.Law": "diffbot_control.law.law:Law",
    "diffbot_sim.simulation.simulate": "diffbot_sim.simulation:simulate",
}
"""Title of each entry, and its ``module:name``."""
_ROLE = re.compile(r":(?:attr|class|data|func|meth|mod):`~?([^`]+)`")


def python_api() -> str:
    """Return the signatures and first sentences of all ENTRIES."""
    return "\n\n".join("\n".join(_entry(name, place)) for name, place in ENTRIES.items())


def _entry(name: str, place: str) -> Iterator[str]:
    module, _, attribute = place.partition(":")
    thing, shown = getattr(import_module(module), attribute), name.rpartition(".")[2]
    yield f"### {name}\n"
    if not inspect.isclass(thing):
        yield f"`{_signature(shown, thing)}`\n\n{_summary(thing)}"
        return
    members = {key: value for key, value in vars(thing).items() if not key.startswith("_")}
    if "__init__" in vars(thing):
        yield f"`{_signature(shown, thing.__init__)}`\n"
    yield f"{_summary(thing)}\n"
    for key, value in members.items():
        if isinstance(value, property) and value.__doc__:
            yield f"- `{key}`: {_summary(value)}"
        elif callable(value) and inspect.getdoc(value):
            yield f"- `{_signature(key, value)}`: {_summary(value)}"


def _signature(name: str, function: Any) -> str:
    parameters = [one for one in inspect.signature(function).parameters.values() if one.name != "self"]
    return f"{name}({', '.join(map(_word, parameters))})"


def _word(parameter: inspect.Parameter) -> str:
    star = {inspect.Parameter.VAR_POSITIONAL: "*", inspect.Parameter.VAR_KEYWORD: "**"}.get(parameter.kind, "")
    word = f"{star}{parameter.name}"
    return word if parameter.default is inspect.Parameter.empty else f"{word}={parameter.default!r}"


def _summary(thing: Any) -> str:
    """Return the first paragraph of a docstring as Markdown."""
    text = " ".join((inspect.getdoc(thing) or "").partition("\n\n")[0].split())
    return _ROLE.sub(r"`\1`", re.sub(r"``([^`]+)``", r"`\1`", text))
