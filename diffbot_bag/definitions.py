"""Find message definitions and type hashes of installed interface packages, in the form that rosbag2 stores."""

from __future__ import annotations

import json
import os
import re
import sys
from pathlib import Path

from diffbot_core.errors import DiffbotError, shown

SEPARATOR = "=" * 80
"""Line before the definition of each nested type."""
_TYPE_NAME = re.compile(r"([a-zA-Z]\w*)/(?:(msg|srv|action)/)?([a-zA-Z]\w*)", re.ASCII)
_PRIMITIVE = re.compile(r"bool|byte|char|float(32|64)|w?string|u?int(8|16|32|64)")
_FIELD_TYPE = re.compile(r"^[ \t]*([a-zA-Z][\w/]*)(?:<=\d+)?(?:\[[^\]]*\])?[ \t]+[a-zA-Z]", re.MULTILINE)
_INDEX = Path("share/ament_index/resource_index/rosidl_interfaces")
"""Folder below a prefix in which packages with interfaces register themselves."""


class DefinitionNotFoundError(DiffbotError):
    """The definition of an interface type is not installed."""


def ament_prefixes() -> list[Path]:
    """Return the prefixes of installed packages: AMENT_PREFIX_PATH, then ``sys.prefix``.

    Wheels install ``share/`` into ``sys.prefix`` and do not set AMENT_PREFIX_PATH.
    """
    paths = os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep)
    return list(dict.fromkeys(Path(path) for path in [*paths, sys.prefix] if path))


def interface_prefixes(package: str) -> list[Path]:
    """Return the prefixes that have ``package`` installed as a package with interfaces."""
    return [prefix for prefix in ament_prefixes() if (prefix / _INDEX / package).is_file()]


def split_type_name(type_name: str) -> tuple[str, str, str]:
    """Split ``pkg/msg/Type`` into package, kind (msg, srv or action) and name.

    Raises:
        DefinitionNotFoundError: if the text is not the name of a type.
    """
    match = _TYPE_NAME.fullmatch(type_name)
    if match is None:
        raise DefinitionNotFoundError(f"{shown(type_name)!r} is not the name of a message type")
    package, kind, name = match.groups()
    return package, kind or "msg", name


def schema_text(type_name: str) -> str:
    """Return the definition of ``pkg/msg/Type``, followed by the definition of each nested type.

    The order of the nested types is the same as in bags of rosbag2: depth first, alphabetical within a type.

    Raises:
        DefinitionNotFoundError: if a definition is not installed.
    """
    included: set[str] = set()

    def append(name: str) -> str:
        text = _installed(name, ".msg")
        package = name.split("/", 1)[0]
        for part in sorted(_types_in(text, package)):
            if part not in included:
                included.add(part)
                text += f"\n{SEPARATOR}\nMSG: {part}\n{append(part)}"
        return text

    return append(type_name)


def type_hash(type_name: str) -> str:
    """Return the hash (``RIHS01_...``) of ``pkg/msg/Type``, as its package declares it.

    Raises:
        DefinitionNotFoundError: if the package does not declare a hash.
    """
    try:
        hashes = json.loads(_installed(type_name, ".json"))["type_hashes"]
        return {entry["type_name"]: str(entry["hash_string"]) for entry in hashes}[type_name]
    except (ValueError, KeyError, TypeError) as error:
        raise DefinitionNotFoundError(f"the package of {type_name} does not declare its type hash") from error


def _installed(type_name: str, suffix: str) -> str:
    package, kind, name = split_type_name(type_name)
    for prefix in ament_prefixes():
        path = prefix / "share" / package / kind / f"{name}{suffix}"
        if path.is_file():
            # Text mode would change \r\n to \n, and so the schema.
            return path.read_bytes().decode()
    raise DefinitionNotFoundError(f"{type_name}: share/{package}/{kind}/{name}{suffix} is not installed")


def _types_in(text: str, package: str) -> set[str]:
    names = {match[1] for match in _FIELD_TYPE.finditer(text)}
    return {name if "/" in name else f"{package}/{name}" for name in names if not _PRIMITIVE.fullmatch(name)}
