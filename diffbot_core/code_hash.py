"""Names for results: a hash of all code that can decide them, and a hash of the configuration they were made with."""

from __future__ import annotations

import hashlib
import importlib.metadata
import importlib.util
import json
import platform
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from diffbot_core.errors import DiffbotError

DIGITS = 16
"""hexadecimal digits of a hash, 64 bits"""


def hash_of_code(packages: Iterable[str], libraries: Iterable[str] = ()) -> str:
    """Hash every module of whole packages, and the versions of the libraries and of Python that run them.

    Whole packages, because a list of the modules that matter goes out of date unnoticed.

    Args:
        packages: names of installed top-level packages.
        libraries: names of installed distributions.

    Raises:
        DiffbotError: if the source of a package or the version of a library is not found.
    """
    return hash_of_folders([_folder(package) for package in packages], libraries)


def hash_of_folders(folders: Iterable[Path], libraries: Iterable[str] = ()) -> str:
    """Hash the modules of packages in these folders, as :func:`hash_of_code` does for installed packages.

    Names count beside contents; the order of the folders and where they are do not.

    Raises:
        DiffbotError: if a folder has no module, or a library is not installed.
    """
    digest = hashlib.sha256(f"{platform.python_implementation()} {platform.python_version()}\n".encode())
    for library in sorted(libraries):
        try:
            digest.update(f"{library} {importlib.metadata.version(library)}\n".encode())
        except importlib.metadata.PackageNotFoundError:
            raise DiffbotError(f"no version of {library} is found to name results by") from None
    for folder in sorted(folders, key=lambda one: one.name):
        modules = sorted(folder.rglob("*.py"))
        if not modules:
            raise DiffbotError(f"{folder} has no source code to name results by")
        for path in modules:
            content = path.read_bytes()
            name = path.relative_to(folder.parent).as_posix()
            # The length keeps what moves from the end of one file to the start of the next from going unnoticed.
            digest.update(f"{name} {len(content)}\n".encode() + content)
    return digest.hexdigest()[:DIGITS]


def _folder(package: str) -> Path:
    spec = importlib.util.find_spec(package)
    if spec is None or not spec.submodule_search_locations:
        raise DiffbotError(f"the source code of {package} is not found to name results by")
    return Path(next(iter(spec.submodule_search_locations)))


def hash_of_values(values: Iterable[Any]) -> str:
    """Hash resolved configurations: named tuples, mappings, sequences and arrays of plain values, nested at will.

    Floats count to their last bit, and the types and field names of named tuples count too: a value in another field
    is another configuration.
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
