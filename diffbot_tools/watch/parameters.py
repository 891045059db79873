"""Parameters of the node ``watch``."""

from __future__ import annotations

from typing import Annotated, NamedTuple

from diffbot_core.errors import InvalidValueError
from diffbot_core.schema import Spec

MAX_ROBOTS = 20


class WatchConfig(NamedTuple):
    """Parameters of the node ``watch``."""

    host: Annotated[str, Spec("address to listen on; 127.0.0.1 is reached from this machine only", read_only=True)] = (
        "127.0.0.1"
    )
    port: Annotated[int, Spec("port to listen on; 0: a free one", minimum=0, maximum=65535, read_only=True)] = 8765
    namespaces: Annotated[tuple[str, ...], Spec("namespace of each robot; empty: none", read_only=True)] = ("",)
    controller: Annotated[str, Spec("name of the controller's node", read_only=True)] = "controller"
    dock_controller: Annotated[str, Spec("name of the node that docks", read_only=True)] = "dock_controller"
    ekf: Annotated[str, Spec("name of the filter's node", read_only=True)] = "ekf"
    plant: Annotated[str, Spec("name of the simulation's node", read_only=True)] = "plant"
    map_frame: Annotated[str, Spec("frame of the goals", read_only=True)] = "map"
    record_folder: Annotated[
        str, Spec("folder for bags that the page records; empty: it records none", read_only=True)
    ] = ""
    open_browser: Annotated[bool, Spec("open the page in the browser", read_only=True)] = False

    def check(self) -> None:
        """Check the number of robots, and that each robot is named once.

        Raises:
            InvalidValueError: if ``namespaces`` is empty, too long, or contains a robot twice.
        """
        if not 1 <= len(self.namespaces) <= MAX_ROBOTS:
            raise InvalidValueError("namespaces", list(self.namespaces), f"from 1 to {MAX_ROBOTS}")
        if len(set(robot_names(self.namespaces))) < len(self.namespaces):
            raise InvalidValueError("namespaces", list(self.namespaces), "each robot once")


def robot_names(namespaces: tuple[str, ...]) -> tuple[str, ...]:
    """Return the names of the robots on the page; a robot without a namespace is ``robot``."""
    return tuple(namespace.strip("/") or "robot" for namespace in namespaces)
