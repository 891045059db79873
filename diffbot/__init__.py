"""Drive differential-drive robots to goal poses, without ROS: the Python interface of diffbot.

    import diffbot

    run = diffbot.drive((1.0, 2.0, 0.0), robot="turtlebot4")
    print(run)
    run.plot("drive.png")

A pose is a tuple or a :class:`Pose` of x [m], y [m] and heading [rad] in map. A path is a ``str`` or a ``Path``.
Each name is imported at its first use, so that ``import diffbot`` does not load other libraries.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from diffbot.arguments import robot
    from diffbot.loop import Controller, Filter
    from diffbot.simulation import Recording, Simulation, drive
    from diffbot_bag.bag import BagReader as Bag
    from diffbot_control.ros.navigator import Navigator
    from diffbot_core.errors import DiffbotError
    from diffbot_core.geometry import Pose
    from diffbot_core.kinematics import Twist
    from diffbot_tools.robot_description import PRESETS as ROBOTS

    __version__: str

_PLACES = {
    "Bag": "diffbot_bag.bag:BagReader",
    **dict.fromkeys(("Controller", "Filter"), "diffbot.loop"),
    "DiffbotError": "diffbot_core.errors",
    "Navigator": "diffbot_control.ros.navigator",
    "Pose": "diffbot_core.geometry",
    "ROBOTS": "diffbot_tools.robot_description:PRESETS",
    **dict.fromkeys(("Recording", "Simulation", "drive"), "diffbot.simulation"),
    "Twist": "diffbot_core.kinematics",
    "robot": "diffbot.arguments",
}
__all__ = [
    "ROBOTS", "Bag", "Controller", "DiffbotError", "Filter", "Navigator", "Pose", "Recording", "Simulation", "Twist",
    "__version__", "drive", "robot",
]  # fmt: skip


def __getattr__(name: str) -> Any:
    if name == "__version__":
        value: Any = import_module("importlib.metadata").version("diffbot-ros")
    elif name in _PLACES:
        module, _, attribute = _PLACES[name].partition(":")
        try:
            value = getattr(import_module(module), attribute or name)
        except ModuleNotFoundError as error:
            from diffbot_core.errors import DiffbotError  # noqa: PLC0415 - `import diffbot` stays fast
            from diffbot_core.launcher import ros_hint  # noqa: PLC0415

            if hint := ros_hint(error):
                raise DiffbotError(f"{name} {hint}") from error
            raise
    else:
        raise AttributeError(f"module 'diffbot' has no attribute {name!r}; it has {', '.join(__all__)}")
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return __all__
