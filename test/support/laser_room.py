"""A node that publishes the map of a room with boxes, the scans of a laser on the simulated robot, and its transform.

Each scan has the stamp of the true pose from which it is calculated.
"""

import contextlib
import math

import numpy as np
import rclpy
from geometry_msgs.msg import TransformStamped
from nav_msgs.msg import OccupancyGrid, Odometry
from rclpy.executors import ExternalShutdownException
from rclpy.qos import qos_profile_sensor_data
from robot import LATCHED, planar, stamp
from sensor_msgs.msg import LaserScan
from tf2_msgs.msg import TFMessage

BOXES = np.array(
    [
        (-5.2, -4.7, 5.2, -4.5), (-5.2, 4.5, 5.2, 4.7), (-5.2, -4.5, -5.0, 4.5), (5.0, -4.5, 5.2, 4.5),
        (-5.0, 1.0, -4.2, 2.2), (-2.5, 3.9, -1.0, 4.5), (2.0, 3.7, 2.6, 4.5), (4.3, -1.4, 5.0, -0.4),
        (0.4, -4.5, 1.6, -3.8),
    ]
)  # fmt: skip
"""xmin, ymin, xmax, ymax [m] of four walls and of boxes beside them; goals are in the free middle"""
CELL = 0.05
"""[m]"""
OFFSET = 0.1
"""[m] of the laser in front of the robot's middle"""
BEAMS, MAX_RANGE, SIGMA, RATE = 360, 12.0, 0.02, 10.0
ANGLES = np.arange(BEAMS) * math.tau / BEAMS - math.pi


def ranges(x, y, theta):
    """Return the distance [m] from a pose in the room to the nearest box in the direction of each beam."""
    at, way = np.array([x, y]), np.stack([np.cos(theta + ANGLES), np.sin(theta + ANGLES)], axis=-1)
    with np.errstate(divide="ignore"):
        sides = (BOXES.reshape(-1, 1, 2, 2) - at) / way[:, None]
    enter, leave = sides.min(axis=2).max(axis=-1), sides.max(axis=2).min(axis=-1)
    return np.where((enter <= leave) & (enter > 0.0), enter, math.inf).min(axis=0)


def room_map():
    """Return the room as the map of a localization."""
    low, high = BOXES.min(axis=0)[:2], BOXES.max(axis=0)[2:]
    width, height = np.rint((high - low) / CELL).astype(int)
    cells = np.zeros((height, width), dtype=np.int8)
    for xmin, ymin, xmax, ymax in np.rint((BOXES - np.tile(low, 2)) / CELL).astype(int):
        cells[ymin:ymax, xmin:xmax] = 100
    message = OccupancyGrid(data=cells.ravel().tolist())
    message.header.frame_id = "map"
    message.info.resolution, message.info.width, message.info.height = CELL, int(width), int(height)
    message.info.origin.position.x, message.info.origin.position.y = map(float, low)
    return message


def main():
    rclpy.init()
    node, chance, last = rclpy.create_node("laser_room"), np.random.default_rng(1), [0]
    scans = node.create_publisher(LaserScan, "scan", qos_profile_sensor_data)
    node.create_publisher(OccupancyGrid, "map", LATCHED).publish(room_map())
    mount = TransformStamped(child_frame_id="laser")
    mount.header.frame_id = "base_link"
    mount.transform.translation.x = OFFSET
    node.create_publisher(TFMessage, "/tf_static", LATCHED).publish(TFMessage(transforms=[mount]))

    def scan(truth):
        if stamp(truth) - last[0] < 0.99e9 / RATE:
            return
        last[0] = stamp(truth)
        x, y, theta = planar(truth.pose.pose)
        exact = ranges(x + OFFSET * math.cos(theta), y + OFFSET * math.sin(theta), theta)
        message = LaserScan(angle_min=-math.pi, angle_max=float(ANGLES[-1]), angle_increment=math.tau / BEAMS)
        message.header.stamp, message.header.frame_id = truth.header.stamp, "laser"
        message.range_min, message.range_max = 0.1, MAX_RANGE
        message.ranges = (exact + SIGMA * chance.standard_normal(BEAMS)).tolist()
        scans.publish(message)

    node.create_subscription(Odometry, "ground_truth", scan, 10)
    with contextlib.suppress(KeyboardInterrupt, ExternalShutdownException):
        rclpy.spin(node)


if __name__ == "__main__":
    main()
