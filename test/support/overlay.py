"""Programs of the ROS installation or overlay of this process."""

from pathlib import Path

import graph
from ament_index_python.packages import get_package_prefix


def program(package, executable, *arguments, **options):
    """Run an executable of a package while the ``with`` block lasts."""
    path = Path(get_package_prefix(package)) / "lib" / package / executable
    return graph.process(str(path), *map(str, arguments), **options)


def ros2(*words, **options):
    """Run a command of ROS while the ``with`` block lasts."""
    return graph.process("ros2", *map(str, words), **options)
