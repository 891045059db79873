"""The simulated robot as the graph sees it: its world, its topics, and the measurements of the present step."""

from __future__ import annotations

from typing import Any

from rclpy.subscription import Subscription
from rclpy.timer import Timer

from diffbot_core.kinematics import Twist
from diffbot_core.ros.node import DiffbotNode
from diffbot_sim.lockstep import MAX_STEPS_WITHOUT_FIX, NO_COMMAND, NO_FILTER, NO_FIX
from diffbot_sim.model.simulator import Arrivals, World
from diffbot_sim.ros.parameters import PlantNodeConfig
from diffbot_sim.ros.publishers import PlantTopics

_OPTIONAL_TOPICS = ("headings", "landmarks")
"""Fields of Arrivals that the filter can answer without; without the first fix it cannot."""


class GraphPlant:
    """The robot in the graph; a :class:`diffbot_sim.lockstep.Plant`."""

    def __init__(self, node: DiffbotNode[PlantNodeConfig], start_stamp: int, commands: Subscription) -> None:
        """Create the world and its publishers.

        Args:
            node: whose parameters and logger are used, and which gets the publishers.
            start_stamp: [ns] time of the first step.
            commands: the subscription to cmd_vel.
        """
        self._node = node
        self._commands = commands
        self._topics = PlantTopics(node)
        self._arrivals: Arrivals | None = None
        self.poll: Timer | None = None
        """timer that :meth:`set_polling` starts and stops"""
        self.world = World(node.config.simulated(), start_stamp)

    @property
    def step(self) -> int:
        """Number of the present step."""
        return self.world.state.step

    def reset(self) -> None:
        """Put the robot back at the start; time goes on, since nodes do not expect messages from the past."""
        self.world = World(self._node.config.simulated(), self.world.stamp + self.world.period)
        self._arrivals = None

    def advance(self, command: Twist) -> None:
        """Hold ``command`` for one step."""
        self.world.advance(command)
        self._arrivals = None

    def publish(self) -> None:
        """Send all messages of the present step, the same ones each time."""
        self._topics.publish(self.world, self._sense())

    def publish_truth(self) -> None:
        """Send time and true state of the present step."""
        self._topics.publish_truth(self.world)

    def awaits_first_fix(self) -> bool:
        """True if there are fixes, and none arrives at the present step."""
        return self._has_fixes() and not self._sense().fixes

    def optional_topics(self) -> set[str]:
        """Topics with a message at the present step that the filter can answer without."""
        arrivals = self._sense()
        return {name for name in _OPTIONAL_TOPICS if getattr(arrivals, name)}

    def connections(self) -> tuple[int, ...] | None:
        """How many nodes are connected to each topic; None until all that a filter needs is subscribed to."""
        if not all(one.get_subscription_count() for one in self._topics.required(self._has_fixes())):
            return None
        return (*self._topics.subscription_counts(), self._commands.get_publisher_count())

    def set_polling(self, active: bool) -> None:
        """Start (or restart) or stop the poll timer."""
        if self.poll is None:
            return
        if active:
            self.poll.reset()
        else:
            self.poll.cancel()

    def report(self, event: str) -> None:
        """Log what the lock-step waits for."""
        logger: Any = self._node.get_logger()
        if event == NO_FILTER:
            topics = " and ".join(publisher.topic_name for publisher in self._topics.required(self._has_fixes()))
            logger.info(f"waiting for a filter on {topics}", throttle_duration_sec=5.0)
        elif event == NO_FIX:
            logger.error(
                f"no fix in the first {MAX_STEPS_WITHOUT_FIX} steps (see fix_delay and fix_dropout):"
                " the filter cannot answer before it has one, or an initialpose"
            )
        elif event == NO_COMMAND:
            logger.warning(
                "no command on cmd_vel: the step's messages are sent again"
                " (is the controller's publish_when_idle set?)",
                throttle_duration_sec=10.0,
            )

    def _has_fixes(self) -> bool:
        return self._node.config.world.sensors.fix_rate > 0.0

    def _sense(self) -> Arrivals:
        """Return the measurements of the present step: the same ones whenever its messages are sent again."""
        if self._arrivals is None:
            self._arrivals = self.world.sense()
        return self._arrivals
