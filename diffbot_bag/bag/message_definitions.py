"""Message definitions and type hashes of the installed interface packages, as rosbag2 stores them in a bag."""

from __future__ import annotations

import json
import os
import re
import sys
from collections.abc import Sequence
from pathlib import Path

from diffbot_core.errors import DiffbotError
from diffbot_core.foreign_files import shown

SEPARATOR = "=" * 80
"""Line between the definition of a type and those of the types it uses."""
PRIMITIVE_TYPES = frozenset({"bool", "byte", "char", "float32", "float64", "string", "wstring"}) | {
    f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64)
}
_TYPE_NAME = re.compile(r"([a-zA-Z]\w*)/(?:(msg|srv|action)/)?([a-zA-Z]\w*)", re.ASCII)
_INDEX = Path("share/ament_index/resource_index/rosidl_interfaces")
"""where a package with interfaces registers itself, below its prefix"""
_FIELD_TYPE = re.compile(r"^[ \t]*([a-zA-Z][\w/]*)(?:<=\d+)?(?:\[[^\]]*\])?[ \t]+[a-zA-Z]", re.MULTILINE)


class DefinitionNotFoundError(DiffbotError):
    """An interface type is not installed, or without its definition."""


def ament_prefixes() -> list[Path]:
    """Return the prefixes of installed packages: AMENT_PREFIX_PATH, then ``sys.prefix``.

    Wheels install ``share/`` into ``sys.prefix`` and set no AMENT_PREFIX_PATH.
    """
    paths = os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep)
    return list(dict.fromkeys(Path(path) for path in [*paths, sys.prefix] if path))


def interface_prefixes(package: str) -> list[Path]:
    """Return the prefixes whose ament index has ``package`` as one with interfaces."""
    return [prefix for prefix in ament_prefixes() if (prefix / _INDEX / package).is_file()]


def split_type_name(type_name: str) -> tuple[str, str, str]:
    """Return package, kind (msg, srv or action) and name of ``pkg/msg/Type``.

    Raises:
        DefinitionNotFoundError: if it is no such name.
    """
    match = _TYPE_NAME.fullmatch(type_name)
    if match is None:
        raise DefinitionNotFoundError(f"{shown(type_name)!r} is not the name of a message type")
    package, kind, name = match.groups()
    return package, kind or "msg", name


class MessageDefinitions:
    """Definitions and hashes of message types; each definition is read once."""

    def __init__(self, prefixes: Sequence[Path] | None = None) -> None:
        """Search these prefixes in order; default: those of :func:`ament_prefixes`."""
        self._prefixes = ament_prefixes() if prefixes is None else list(prefixes)
        self._texts: dict[str, str] = {}

    def schema_text(self, type_name: str) -> str:
        """Return the definition of ``pkg/msg/Type`` followed by those of all nested types, depth first, once each.

        Types at one level come in alphabetical order, as in bags of rosbag2.

        Raises:
            DefinitionNotFoundError: if a definition is not installed.
        """
        included: set[str] = set()

        def append(name: str) -> str:
            text = self._text(name)
            package = name.split("/", 1)[0]
            for part in sorted(_types_in(text, package)):
                if part not in included:
                    included.add(part)
                    text += f"\n{SEPARATOR}\nMSG: {part}\n{append(part)}"
            return text

        return append(type_name)

    def type_hash(self, type_name: str) -> str:
        """Return the hash (``RIHS01_...``) of ``pkg/msg/Type`` that its package declares.

        Raises:
            DefinitionNotFoundError: if the package declares none.
        """
        path = self._find(type_name, ".json")
        try:
            hashes = json.loads(path.read_text(encoding="utf-8"))["type_hashes"]
            return {entry["type_name"]: str(entry["hash_string"]) for entry in hashes}[type_name]
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise DefinitionNotFoundError(f"no type hash of {type_name} in {path}") from error

    def _text(self, type_name: str) -> str:
        if type_name not in self._texts:
            # Read as bytes: text mode would turn \r\n into \n and so change the schema.
            self._texts[type_name] = self._find(type_name, ".msg").read_bytes().decode()
        return self._texts[type_name]

    def _find(self, type_name: str, suffix: str) -> Path:
        package, kind, name = split_type_name(type_name)
        for prefix in self._prefixes:
            path = prefix / "share" / package / kind / f"{name}{suffix}"
            if path.is_file():
                return path
        raise DefinitionNotFoundError(f"{type_name}: no share/{package}/{kind}/{name}{suffix} installed")


def _types_in(text: str, package: str) -> set[str]:
    found = set()
    for match in _FIELD_TYPE.finditer(text):
        name = match.group(1)
        if name not in PRIMITIVE_TYPES:
            found.add(name if "/" in name else f"{package}/{name}")
    return found
