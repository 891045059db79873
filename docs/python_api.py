"""Write the reference of the Python interface as Markdown, from signatures and Google-style docstrings."""

from __future__ import annotations

import inspect
import re
import textwrap
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
_SECTIONS = ("Args", "Returns", "Raises", "Examples", "Yields")
_ROLE = re.compile(r":(?:attr|class|data|func|meth|mod):`~?([^`]+)`")
_QUALIFIED = re.compile(r"\b(?:[a-z_]\w*\.)+(?=\w)")


def python_api() -> str:
    """Return the reference of all ENTRIES."""
    return "\n\n".join("\n\n".join(_entry(name, place)) for name, place in ENTRIES.items())


def _entry(name: str, place: str) -> Iterator[str]:
    module, _, attribute = place.partition(":")
    thing = getattr(import_module(module), attribute)
    yield f"## {name}"
    if not inspect.isclass(thing):
        yield _signature(name.rpartition(".")[2], thing)
        yield _text(thing)
        return
    own = {key: value for key, value in vars(thing).items() if key == "__init__" or not key.startswith("_")}
    if "__init__" in own:
        yield _signature(name.rpartition(".")[2], own["__init__"])
    yield _text(thing)
    for key, value in own.items():
        if key == "__init__":
            yield _text(value)
        elif isinstance(value, property) and value.__doc__:
            yield f"**`{key}`**: {_text(value)}"
        elif callable(value) and inspect.getdoc(value):
            yield f"### {name.rpartition('.')[2]}.{key}"
            yield _signature(key, value)
            yield _text(value)


def _signature(name: str, function: Any) -> str:
    parameters = [one for one in inspect.signature(function).parameters.values() if one.name != "self"]
    words = [_word(one) for one in parameters]
    line = f"{name}({', '.join(words)})"
    if len(line) > 90:
        line = f"{name}(\n    " + ",\n    ".join(words) + ",\n)"
    return f"```python\n{line}\n```"


def _word(parameter: inspect.Parameter) -> str:
    star = {inspect.Parameter.VAR_POSITIONAL: "*", inspect.Parameter.VAR_KEYWORD: "**"}.get(parameter.kind, "")
    kind = parameter.annotation if isinstance(parameter.annotation, str) else ""
    word = f"{star}{parameter.name}" + (f": {_QUALIFIED.sub('', kind)}" if kind else "")
    return word if parameter.default is inspect.Parameter.empty else f"{word} = {parameter.default!r}"


def _text(thing: Any) -> str:
    """Return a docstring as Markdown, with sections as lists and examples as code."""
    parts, title, lines = [], "", list[str]()
    for line in [*(inspect.getdoc(thing) or "").splitlines(), "End:"]:
        if line.endswith(":") and line[:-1] in (*_SECTIONS, "End"):
            parts.append(_section(title, textwrap.dedent("\n".join(lines)).strip()))
            title, lines = line[:-1], []
        else:
            lines.append(line)
    return "\n\n".join(part for part in parts if part)


def _section(title: str, text: str) -> str:
    if title == "Examples":
        return f"```pycon\n{text}\n```"
    text = _ROLE.sub(r"`\1`", re.sub(r"``([^`]+)``", r"`\1`", text))
    if title in ("Args", "Raises"):
        items = re.split(r"\n(?=\S)", text)
        text = "\n".join("- " + re.sub(r"^([\w*]+):", r"`\1`:", " ".join(one.split())) for one in items)
        return f"{'Arguments' if title == 'Args' else title}:\n\n{text}"
    return f"{title}: {text}" if title else text
