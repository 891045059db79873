"""The plant's beams as sensor_msgs/Range."""

from __future__ import annotations

from sensor_msgs.msg import Range

from diffbot_control.ros.frames import robot_frame
from diffbot_control.ros.messages.fields import set_stamp
from diffbot_core.ros.node import QUEUE, DiffbotNode
from diffbot_sim.model.beams import MIN_RANGE, measured_range, true_range
from diffbot_sim.model.philox import NoiseKey
from diffbot_sim.model.sensors import due
from diffbot_sim.model.simulator import World
from diffbot_sim.ros.parameters import PlantNodeConfig


class BeamTopics:
    """A publisher for each beam."""

    def __init__(self, node: DiffbotNode[PlantNodeConfig]) -> None:
        """Create the publishers on ``node``, whose health counts what is sent."""
        self._node = node
        beams = node.config.beams.map.beams()
        self._beams = [(beam, node.create_publisher(Range, topic, QUEUE)) for topic, beam in beams.items()]
        self._message = Range(radiation_type=Range.INFRARED, min_range=MIN_RANGE)
        self._message.header.frame_id = robot_frame(node.config)

    def publish(self, world: World) -> None:
        """Send the ranges that are due at the present step."""
        config, key = self._node.config.beams, NoiseKey(world.config.seed, world.config.run, world.state.step)
        if not self._beams or not due(key.step, config.beam_rate, world.config.plant.sampling_time):
            return
        message, walls = self._message, config.map.walls()
        set_stamp(message.header.stamp, world.stamp)
        message.max_range, message.variance = config.beam_max_range, config.variance()
        for index, (beam, publisher) in enumerate(self._beams):
            message.range = measured_range(key, index, true_range(world.state.pose, beam, walls), config)
            publisher.publish(message)
            self._node.health.sent[publisher.topic] += 1
