"""The name of the project for pip. The ROS package, the command and the import are called ``diffbot``.

Another project has the name ``diffbot`` on the Python package index.
"""

from __future__ import annotations

from importlib.metadata import EntryPoint, entry_points

DISTRIBUTION = "diffbot-ros"


def install_hint(extra: str) -> str:
    """Return the command that installs an extra."""
    return f"pip install '{DISTRIBUTION}[{extra}]'"


def entry_points_by_name(group: str) -> dict[str, EntryPoint]:
    """Return the entry points of a group by name, in the order of the names.

    Of several with one name, the first one on the path counts: a workspace may lie over an installation by pip, and an
    earlier version may have another name.
    """
    found = {one.name: one for one in reversed(tuple(entry_points(group=group)))}
    return dict(sorted(found.items()))
