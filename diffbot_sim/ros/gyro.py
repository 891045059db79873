"""The plant's gyro as sensor_msgs/Imu."""

from __future__ import annotations

from sensor_msgs.msg import Imu

from diffbot_control.ros.frames import robot_frame
from diffbot_control.ros.messages.fields import set_stamp
from diffbot_core.ros.node import QUEUE, DiffbotNode
from diffbot_sim.model.simulator import World
from diffbot_sim.ros.parameters import PlantNodeConfig


class GyroTopic:
    """The publisher of imu."""

    def __init__(self, node: DiffbotNode[PlantNodeConfig]) -> None:
        """Create the publisher on ``node``, whose health counts what is sent."""
        self._sent = node.health.sent
        self._publisher = node.create_publisher(Imu, "imu", QUEUE)
        self._message = Imu()
        self._message.header.frame_id = robot_frame(node.config)
        # REP-145: no orientation, no acceleration in it.
        self._message.orientation_covariance[0] = -1.0
        self._message.linear_acceleration_covariance[0] = -1.0
        self._message.angular_velocity_covariance[[0, 4]] = 1e6

    def publish(self, world: World) -> None:
        """Send the mean turn rate over the step that ends now, if it is due."""
        reading = world.turn_rate()
        if reading is None:
            return
        message = self._message
        set_stamp(message.header.stamp, reading.stamp)
        message.angular_velocity.z = reading.rate
        message.angular_velocity_covariance[8] = reading.variance
        self._publisher.publish(message)
        self._sent["imu"] += 1
