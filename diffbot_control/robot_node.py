"""The nodes ``ekf`` and ``controller`` in one process: the ekf calls the controller with each pose."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from diffbot_control.controller_node import ControllerNode
from diffbot_control.ekf_node import EkfNode
from diffbot_core.errors import DiffbotError
from diffbot_core.ros.run import run


class RobotControllerNode(ControllerNode):
    """A controller that the ekf in the same process calls with each pose."""

    def __init__(self, ekf: EkfNode, **node_options: Any) -> None:
        """Create the node.

        Args:
            ekf: node ``ekf`` in the same context.
            node_options: options of rclpy's Node.

        Raises:
            DiffbotError: if the frames of the two nodes differ, or a parameter is invalid.
        """
        self._ekf = ekf
        super().__init__(**node_options)

    def _receive_poses(self, topic: str) -> None:
        """Register with the ekf, or subscribe to the topic if the ekf does not publish on it."""
        if self.resolve_topic_name(topic) != self._ekf.resolve_topic_name(topic):
            self.get_logger().info(f"{topic} is not published by the ekf of this process: subscribing to it")
            super()._receive_poses(topic)
            return
        # A subscription would check these frames in each message.
        for frame in ("map_frame",) if topic == "pose" else ("map_frame", "base_link_frame", "frame_prefix"):
            mine, other = getattr(self.config, frame), getattr(self._ekf.config, frame)
            if mine != other:
                raise DiffbotError(
                    f"{frame} is {mine!r} in the controller, but {other!r} in the ekf: set both to the same frame"
                )
        # An error of the controller must not count as an error of the ekf, which calls it.
        self._ekf.pose_receiver = self.contained(self.take_pose, topic)


def make_nodes() -> Iterator[EkfNode | ControllerNode]:
    """Create the filter, then the controller."""
    ekf = EkfNode()
    yield ekf
    yield RobotControllerNode(ekf)


def main(args: list[str] | None = None) -> int:
    """Run both nodes on one executor; return the exit status of the process."""
    return run(make_nodes, args, shared_memory=False)


if __name__ == "__main__":
    raise SystemExit(main())
