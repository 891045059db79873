"""TF: the transforms that a node looks up, and ``map`` -> ``odom``, which the ekf sends.

tf2_ros exists in full ROS installations only. Without it a node receives static transforms itself, if tf2_msgs is
installed. Without both there are no transforms.
"""

from __future__ import annotations

from typing import Any

from rclpy.time import Time

from diffbot_control.ros.messages.conversions import TFMessage, transform_message
from diffbot_control.ros.messages.fields import stamp_ns
from diffbot_control.ros.transforms import NO_TRANSFORMS, StaticTransforms, Transforms
from diffbot_core.errors import BadMessageError
from diffbot_core.geometry import Pose, origin_of_frame
from diffbot_core.ros.qos import STATIC_TRANSFORMS, TRANSFORMS
from diffbot_core.stamps import NS_PER_S

TF_TOPIC, STATIC_TOPIC = "/tf", "/tf_static"


class Tf2Transforms:
    """Transforms that tf2_ros receives for a node."""

    available = True

    def __init__(self, tf2_ros: Any, node: Any, tolerance: float) -> None:
        """Subscribe to /tf and /tf_static.

        Args:
            tf2_ros: the module.
            node: the node that spins.
            tolerance: [s] by which the newest transform may be older than the pose or vector to transform.
        """
        self._tf2_ros = tf2_ros
        self._tolerance = round(tolerance * NS_PER_S)
        self._buffer = tf2_ros.Buffer()
        self._listener = tf2_ros.TransformListener(self._buffer, node)

    def lookup(self, target: str, source: str, stamp: int) -> Any:
        """Return a transform; the newest one if it is older than ``stamp`` by no more than the tolerance."""
        try:
            try:
                return self._buffer.lookup_transform(target, source, Time(nanoseconds=stamp)).transform
            except self._tf2_ros.ExtrapolationException:
                newest = self._buffer.lookup_transform(target, source, Time())
                if not 0 <= stamp - stamp_ns(newest.header.stamp) <= self._tolerance:
                    raise
                return newest.transform
        except self._tf2_ros.TransformException as error:
            reason = " ".join(str(error).split())
            raise BadMessageError("no transform", f"{source[:80]!r} to {target!r}: {reason}") from None


def transforms_of(node: Any, tolerance: float) -> Transforms:
    """Return the transforms that ``node`` can look up; ``tolerance`` is that of :class:`Tf2Transforms` [s]."""
    try:
        import tf2_ros  # noqa: PLC0415 - not installed everywhere
    except ImportError:
        return NO_TRANSFORMS if TFMessage is None else received_transforms(node)
    return Tf2Transforms(tf2_ros, node, tolerance)


def received_transforms(node: Any) -> StaticTransforms:
    """Return the static transforms that ``node`` receives on /tf_static from now on."""
    found = StaticTransforms()

    def receive(message: Any) -> None:
        for one in message.transforms:
            found.add(one.header.frame_id, one.child_frame_id, one.transform)

    node.create_subscription(TFMessage, STATIC_TOPIC, receive, STATIC_TRANSFORMS)
    return found


class TransformSender:
    """Publishes ``map`` -> ``odom`` from the estimates and the pose in the odometry's own frame."""

    def __init__(self, node: Any, map_frame: str, odom_frame: str, tolerance: float) -> None:
        """Create the publisher of /tf.

        Args:
            node: the node that publishes.
            map_frame: the parent.
            odom_frame: the child, with its prefix.
            tolerance: [s] by which stamps are set into the future, which is how long a transform is valid, as in AMCL.
        """
        self._frames = map_frame, odom_frame
        self._tolerance = round(tolerance * NS_PER_S)
        self._publisher = node.create_publisher(TFMessage, TF_TOPIC, TRANSFORMS)

    def send(self, stamp: int, in_map: Pose, in_odom: Pose) -> None:
        """Send the transform from two poses of the robot at ``stamp`` [ns]: the estimate and the odometry's own."""
        of_odom = origin_of_frame(in_odom, in_map)
        self._publisher.publish(transform_message(stamp + self._tolerance, *self._frames, of_odom))


def transform_sender(node: Any, map_frame: str, odom_frame: str, tolerance: float) -> TransformSender | None:
    """Return a sender; without tf2_msgs, log that and return None."""
    if TFMessage is None:
        node.get_logger().info("tf2_msgs is not installed: no TF is published")
        return None
    return TransformSender(node, map_frame, odom_frame, tolerance)
