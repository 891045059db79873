"""Parameters of the node ``watch``."""

from __future__ import annotations

import re
from typing import Annotated, NamedTuple

from diffbot_core.errors import InvalidValueError
from diffbot_core.schema import Spec

MAX_ROBOTS = 20
_NAMESPACE = re.compile(r"/?([A-Za-z_][A-Za-z0-9_]*(/[A-Za-z_][A-Za-z0-9_]*)*/?)?")


class WatchConfig(NamedTuple):
    """Parameters of the node ``watch``."""

    host: Annotated[str, Spec("address to listen on; 127.0.0.1 serves this machine only", read_only=True)] = "127.0.0.1"
    port: Annotated[int, Spec("port to listen on; 0 chooses a free port", minimum=0, maximum=65535, read_only=True)] = (
        8765
    )
    namespaces: Annotated[
        tuple[str, ...], Spec("namespace of each robot; an empty text is a robot without a namespace", read_only=True)
    ] = ("",)
    controller: Annotated[str, Spec("name of the controller node", read_only=True)] = "controller"
    dock_controller: Annotated[str, Spec("name of the docking controller node", read_only=True)] = "dock_controller"
    ekf: Annotated[str, Spec("name of the filter node", read_only=True)] = "ekf"
    plant: Annotated[str, Spec("name of the plant node", read_only=True)] = "plant"
    map_frame: Annotated[str, Spec("frame of the goals", read_only=True)] = "map"
    record_folder: Annotated[
        str, Spec("folder for bags that the page records; empty disables the record button", read_only=True)
    ] = ""
    open_browser: Annotated[bool, Spec("open the page in the browser", read_only=True)] = False

    def check(self) -> None:
        """Check the number of robots and their names, and that no robot is named twice.

        Raises:
            InvalidValueError: if ``namespaces`` is empty, too long, or contains a repeated or invalid name.
        """
        if not 1 <= len(self.namespaces) <= MAX_ROBOTS:
            raise InvalidValueError("namespaces", list(self.namespaces), f"a list of 1 to {MAX_ROBOTS} names")
        if len(set(robot_names(self.namespaces))) < len(self.namespaces):
            raise InvalidValueError("namespaces", list(self.namespaces), sentence="a robot appears twice")
        if not all(map(_NAMESPACE.fullmatch, self.namespaces)):
            text = "a namespace has only letters, digits and _, and no part of it begins with a digit"
            raise InvalidValueError("namespaces", list(self.namespaces), sentence=text)


def robot_names(namespaces: tuple[str, ...]) -> tuple[str, ...]:
    """Return the names of the robots on the page; a robot without a namespace is ``robot``."""
    return tuple(namespace.strip("/") or "robot" for namespace in namespaces)
