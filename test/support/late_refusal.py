"""A controller that can use a goal when an action asks, and cannot any more when it accepts the goal."""

from diffbot_control import controller_node
from diffbot_control.ros.goals.server import GoalServer
from diffbot_core.errors import BadMessageError


def refuse(*_args):
    raise BadMessageError("the transform is too old")


if __name__ == "__main__":
    GoalServer.accept = refuse
    raise SystemExit(controller_node.main())
