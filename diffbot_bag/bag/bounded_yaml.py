"""Read YAML of unknown origin: without aliases, bounded in size, depth and number of values; and write YAML."""

from __future__ import annotations

from collections import Counter
from typing import Any

import yaml

from diffbot_bag.bag.foreign_files import shown
from diffbot_core.errors import DiffbotError

MAX_CHARACTERS = 4 * 2**20
MAX_VALUES = 200_000
MAX_DEPTH = 20
"""of lists and maps in each other; metadata.yaml has 7"""
MAX_DIGITS = 64
"""of a number: longer ones take Python quadratic time, and are too long to be shown"""


_DUMPER = getattr(yaml, "CSafeDumper", yaml.SafeDumper)


class _Loader(getattr(yaml, "CSafeLoader", yaml.SafeLoader)):  # type: ignore[misc]
    """The safe loader, for numbers of a bounded length."""


def _bounded(construct: Any) -> Any:
    def constructed(loader: Any, node: yaml.ScalarNode) -> Any:
        if len(node.value) > MAX_DIGITS:
            raise yaml.YAMLError("a number of too many digits")
        return construct(loader, node)

    return constructed


_Loader.add_constructor("tag:yaml.org,2002:int", _bounded(_Loader.construct_yaml_int))
_Loader.add_constructor("tag:yaml.org,2002:float", _bounded(_Loader.construct_yaml_float))


class _UniqueKeys(_Loader):
    """Refuses a key that stands twice in a map, of which YAML keeps the last."""

    def construct_mapping(self, node: Any, deep: bool = False) -> dict[Any, Any]:
        keys = [key.value for key, _ in node.value if isinstance(key, yaml.ScalarNode)]
        if twice := next((key for key, count in Counter(keys).items() if count > 1), ""):
            raise DuplicateKeyError(f"{shown(twice)!r} stands there twice")
        return dict(super().construct_mapping(node, deep))


class DuplicateKeyError(DiffbotError):
    """A map of a YAML document has a key twice."""


def load_yaml(text: str, name: str, *, unique_keys: bool = False) -> Any:
    """Return the content of a YAML document of plain values.

    Args:
        text: the document.
        name: of the document, for the error.
        unique_keys: refuse a map with a key twice, for what people write by hand.

    Raises:
        DiffbotError: if it is not YAML, has an alias, or breaks a bound of this module.
    """
    if len(text) > MAX_CHARACTERS:
        raise DiffbotError(f"{name} has {len(text)} characters: must be <= {MAX_CHARACTERS}")
    try:
        _check(text, name)
        return yaml.load(text, _UniqueKeys if unique_keys else _Loader)
    except DuplicateKeyError as error:
        raise DiffbotError(f"{name}: {error}") from None
    except (yaml.YAMLError, ValueError, TypeError, OverflowError, AttributeError) as error:
        # All but the first come from PyYAML's constructors, for example of the date 2001-99-99.
        raise DiffbotError(f"{name} is not a YAML file") from error


def dump_yaml(content: Any) -> str:
    """Return plain values as YAML, in their order; by libyaml where PyYAML has it, ten times as fast."""
    return str(yaml.dump(content, Dumper=_DUMPER, sort_keys=False))


def _check(text: str, name: str) -> None:
    """Check the bounds on the stream of events, whose parser needs little memory and no recursion."""
    depth = values = 0
    for event in yaml.parse(text, _Loader):
        if isinstance(event, yaml.AliasEvent):
            raise DiffbotError(f"{name} has an alias (*{shown(event.anchor)}), which is not allowed")
        if isinstance(event, (yaml.CollectionStartEvent, yaml.ScalarEvent)):
            values += 1
        if isinstance(event, yaml.CollectionStartEvent):
            depth += 1
        elif isinstance(event, yaml.CollectionEndEvent):
            depth -= 1
        if depth > MAX_DEPTH:
            raise DiffbotError(f"{name} is nested deeper than {MAX_DEPTH} levels")
        if values > MAX_VALUES:
            raise DiffbotError(f"{name} has more than {MAX_VALUES} values")
