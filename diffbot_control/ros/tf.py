"""TF: transforms that a node looks up, and the transform ``map`` -> ``odom`` that the ekf publishes.

Only full ROS installations contain tf2_ros. Without tf2_ros, a node receives static transforms itself if tf2_msgs is
installed. Without both, no transform is available.
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
            tf2_ros: module tf2_ros.
            node: node that receives the transforms.
            tolerance: time by which the newest transform may be older than the requested stamp [s].
        """
        self._tf2_ros = tf2_ros
        self._tolerance = round(tolerance * NS_PER_S)
        self._buffer = tf2_ros.Buffer()
        self._listener = tf2_ros.TransformListener(self._buffer, node)

    def lookup(self, target: str, source: str, stamp: int) -> Any:
        """Return the transform at ``stamp``, or the newest transform if it is older by at most the tolerance."""
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
    """Return the transforms that ``node`` can look up; ``tolerance`` [s] is as in :class:`Tf2Transforms`."""
    try:
        import tf2_ros  # noqa: PLC0415 - not installed everywhere
    except ImportError:
        pass
    else:
        return Tf2Transforms(tf2_ros, node, tolerance)
    if TFMessage is None:
        return NO_TRANSFORMS
    transforms = StaticTransforms()

    def receive(message: Any) -> None:
        for stamped in message.transforms:
            transforms.add(stamped.header.frame_id, stamped.child_frame_id, stamped.transform)

    node.create_subscription(TFMessage, STATIC_TOPIC, receive, STATIC_TRANSFORMS)
    return transforms


class TransformSender:
    """Publishes ``map`` -> ``odom``, computed from the poses of the robot in both frames."""

    def __init__(self, node: Any, map_frame: str, odom_frame: str, tolerance: float) -> None:
        """Create the publisher of /tf.

        Args:
            node: node that publishes.
            map_frame: parent frame.
            odom_frame: child frame with its prefix.
            tolerance: time by which transforms are stamped into the future [s], as ``transform_tolerance`` of AMCL.
        """
        self._frames = map_frame, odom_frame
        self._tolerance = round(tolerance * NS_PER_S)
        self._publisher = node.create_publisher(TFMessage, TF_TOPIC, TRANSFORMS)

    def send(self, stamp: int, in_map: Pose, in_odom: Pose) -> None:
        """Publish the transform, given the poses of the robot in ``map`` and ``odom`` at ``stamp`` [ns]."""
        odom = origin_of_frame(in_odom, in_map)
        self._publisher.publish(transform_message(stamp + self._tolerance, *self._frames, odom))


def transform_sender(node: Any, map_frame: str, odom_frame: str, tolerance: float) -> TransformSender | None:
    """Return a :class:`TransformSender`; if tf2_msgs is not installed, log this and return None."""
    if TFMessage is None:
        node.get_logger().info("tf2_msgs is not installed: no TF is published")
        return None
    return TransformSender(node, map_frame, odom_frame, tolerance)
