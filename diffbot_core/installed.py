"""What is installed: the distribution, entry points of plug-ins, and a hash of the code that names results."""

from __future__ import annotations

import hashlib
import importlib.metadata
import importlib.util
import json
import platform
from collections.abc import Iterable
from importlib.metadata import EntryPoint
from pathlib import Path
from typing import Any

from diffbot_core.errors import DiffbotError

DISTRIBUTION = "diffbot-ros"
"""Name for pip. The ROS package, the command and the import are called diffbot, which is another project's on PyPI."""
DIGITS = 16
"""hexadecimal digits of a hash, 64 bits"""


def install_hint(extra: str) -> str:
    """Return the command that installs an extra."""
    return f"pip install '{DISTRIBUTION}[{extra}]'"


def entry_points_by_name(group: str) -> dict[str, EntryPoint]:
    """Return the entry points of a group by name, sorted.

    Of several with one name, the first one on the path counts: a workspace may lie over an installation by pip.
    """
    found = {one.name: one for one in reversed(tuple(importlib.metadata.entry_points(group=group)))}
    return dict(sorted(found.items()))


def hash_of_code(packages: Iterable[str], libraries: Iterable[str] = ()) -> str:
    """Hash every module of whole packages, and the versions of the libraries and of Python that run them.

    Whole packages, because a list of the modules that matter goes out of date unnoticed. Names of modules count beside
    contents; where the packages are installed does not.

    Args:
        packages: names of installed top-level packages.
        libraries: names of installed distributions.

    Raises:
        DiffbotError: if the source of a package or the version of a library is not found.
    """
    digest = hashlib.sha256(f"{platform.python_implementation()} {platform.python_version()}\n".encode())
    for library in sorted(libraries):
        try:
            digest.update(f"{library} {importlib.metadata.version(library)}\n".encode())
        except importlib.metadata.PackageNotFoundError:
            raise DiffbotError(f"the version of {library} is not found, so results cannot be named by it") from None
    for package in sorted(packages):
        spec = importlib.util.find_spec(package)
        folder = Path(next(iter(spec.submodule_search_locations or [""]))) if spec else Path("")
        modules = sorted(folder.rglob("*.py")) if folder.name else []
        if not modules:
            raise DiffbotError(f"the source code of {package} is not found, so results cannot be named by it")
        for path in modules:
            content = path.read_bytes()
            # With the length, moving code from the end of one file to the start of the next changes the hash.
            digest.update(f"{path.relative_to(folder.parent).as_posix()} {len(content)}\n".encode() + content)
    return digest.hexdigest()[:DIGITS]


def hash_of_values(values: Iterable[Any]) -> str:
    """Hash resolved configurations: named tuples, mappings, sequences and arrays of plain values, nested at will.

    Floats count to their last bit. The types and field names of named tuples count, too: a value in another field is
    another configuration.
    """
    digest = hashlib.sha256()
    for value in values:
        digest.update(json.dumps(_canonical(value), sort_keys=True).encode() + b"\n")
    return digest.hexdigest()[:DIGITS]


def _canonical(value: Any) -> Any:
    """Return ``value`` as JSON holds it; floats are written by repr, which is exact."""
    if isinstance(value, tuple) and hasattr(value, "_fields"):
        fields = {name: _canonical(one) for name, one in zip(value._fields, value, strict=True)}
        return {type(value).__name__: fields}
    if isinstance(value, dict):
        return {name: _canonical(one) for name, one in value.items()}
    if isinstance(value, (list, tuple)):
        return [_canonical(one) for one in value]
    return value.tolist() if hasattr(value, "tolist") else value
