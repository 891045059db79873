"""The nodes ``ekf`` and ``controller`` in one process: the ekf calls the controller with each pose."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from diffbot_control.controller_node import ControllerNode
from diffbot_control.ekf_node import EkfNode
from diffbot_core.errors import DiffbotError
from diffbot_core.ros.run import run


class RobotControllerNode(ControllerNode):
    """The controller, which receives the pose from the filter of its process by a call."""

    def __init__(self, ekf: EkfNode, **node_options: Any) -> None:
        """Create the node.

        Args:
            ekf: the filter, in the same context.
            node_options: options of rclpy's Node.

        Raises:
            DiffbotError: if the frames of the two nodes differ, or a parameter is not allowed.
        """
        self._ekf = ekf
        super().__init__(**node_options)

    def _receive_poses(self, topic: str) -> None:
        """Receive the pose by a call, or subscribe to its topic if it is not the topic of the filter."""
        if self.resolve_topic_name(topic) != self._ekf.resolve_topic_name(topic):
            self.get_logger().info(f"{topic} is not that of this process's ekf: subscribing to it")
            super()._receive_poses(topic)
            return
        # The frames that are compared in a message.
        for frame in ("map_frame",) if topic == "pose" else ("map_frame", "base_link_frame", "frame_prefix"):
            mine, other = getattr(self.config, frame), getattr(self._ekf.config, frame)
            if mine != other:
                raise DiffbotError(f"{frame}: the controller has {mine!r}, the ekf {other!r}: must be the same")
        # An error of the controller must not count as an error of the filter that calls it.
        self._ekf.pose_receiver = self.contained(self.take_pose, topic)


def make_nodes() -> Iterator[EkfNode | ControllerNode]:
    """Create the two nodes, the filter first."""
    ekf = EkfNode()
    yield ekf
    yield RobotControllerNode(ekf)


def main(args: list[str] | None = None) -> int:
    """Run both nodes on one executor; return the exit status of the process."""
    return run(make_nodes, args, shared_memory=False)


if __name__ == "__main__":
    raise SystemExit(main())
