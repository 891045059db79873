"""Find plug-ins of installed packages, and hash the code of packages to identify results."""

from __future__ import annotations

import hashlib
import importlib.metadata
import importlib.util
import platform
from collections.abc import Iterable
from importlib.metadata import EntryPoint
from pathlib import Path

from diffbot_core.errors import DiffbotError

DISTRIBUTION = "diffbot-ros"
"""Name for pip; on PyPI, the name diffbot belongs to another project."""
DIGITS = 16
"""Number of hexadecimal digits of a hash."""


def install_hint(extra: str) -> str:
    """Return the pip command that installs an extra of this package."""
    return f"pip install '{DISTRIBUTION}[{extra}]'"


def entry_points_by_name(group: str) -> dict[str, EntryPoint]:
    """Return the entry points of a group, sorted by name.

    If several entry points have the same name, the first one on ``sys.path`` is returned. A colcon workspace overlays
    an installation by pip in this way.
    """
    found = {one.name: one for one in reversed(tuple(importlib.metadata.entry_points(group=group)))}
    return dict(sorted(found.items()))


def hash_of_code(packages: Iterable[str], libraries: Iterable[str] = ()) -> str:
    """Hash the names and contents of all modules of some packages, and the versions of libraries and of Python.

    All modules are hashed, because a list of the relevant modules would become outdated without notice.

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
            raise DiffbotError(f"cannot identify the results: the version of {library} is not found") from None
    for package in sorted(packages):
        spec = importlib.util.find_spec(package)
        folder = Path(next(iter(spec.submodule_search_locations or [""]))) if spec else Path("")
        modules = sorted(folder.rglob("*.py")) if folder.name else []
        if not modules:
            raise DiffbotError(f"cannot identify the results: the source code of {package} is not found")
        for path in modules:
            content = path.read_bytes()
            # The length separates the files: moving a line from one file to the next changes the hash.
            digest.update(f"{path.relative_to(folder.parent).as_posix()} {len(content)}\n".encode() + content)
    return digest.hexdigest()[:DIGITS]
