"""Topics of a refiltered bag: pose and odometry/filtered as the node ``ekf`` publishes them, and the innovations."""

from __future__ import annotations

from diffbot_bag.bag.encoding import ODOMETRY, POSE, Encoder, NumbersMessage
from diffbot_bag.bag.writer import BagWriter
from diffbot_control.filter.localization import FilterEstimate
from diffbot_control.ros.messages.fields import fill_planar_covariance, fill_twist_covariance, fill_unestimated
from diffbot_core.geometry import quaternion_of_yaw
from diffbot_tools.refilter.filter_run import Answer, Innovation
from diffbot_tools.refilter.nis_topic import NIS_LABELS, NIS_TOPIC

NIS = "std_msgs/msg/Float64MultiArray"


class OutputTopics:
    """Writes answers and innovations to a bag.

    ``/ekf/nis`` has one message per measurement: its NIS, how many numbers were measured, and 1 if it was accepted. Its
    publish time is the stamp of the measurement, its log time that of the odometry with which it was fused.
    """

    def __init__(self, writer: BagWriter, encoder: Encoder, map_frame: str, base_link_frame: str) -> None:
        """Register the topics."""
        self._writer, self._encoder = writer, encoder
        self._pose = NumbersMessage(POSE, map_frame)
        self._odometry = NumbersMessage(ODOMETRY, map_frame, base_link_frame)
        fill_unestimated(self._pose.pose_covariance)
        fill_unestimated(self._odometry.pose_covariance, self._odometry.twist_covariance)
        self._poses = writer.add_topic("/pose", POSE)
        self._filtered = writer.add_topic("/odometry/filtered", ODOMETRY)
        self._nis = writer.add_topic(NIS_TOPIC, NIS)
        self._written = 0

    def write(self, answer: Answer, log_time: int) -> None:
        """Write pose and odometry/filtered with the stamp of the estimate; ``log_time`` [ns]."""
        estimate, odometry, twist = answer
        stamp = estimate.stamp
        for message in (self._pose, self._odometry):
            _fill(message, estimate)
        self._odometry.twist[[0, 5]] = twist
        fill_twist_covariance(self._odometry.twist_covariance, odometry.covariance)
        self._writer.write(self._poses, self._pose.encode(stamp), log_time, stamp)
        self._writer.write(self._filtered, self._odometry.encode(stamp), log_time, stamp)

    def write_innovations(self, innovations: list[Innovation], log_time: int) -> None:
        """Write those of a growing list that were not written before; ``log_time`` [ns]."""
        if len(innovations) == self._written:
            return
        layout = {"dim": [{"label": label, "size": 1, "stride": 1} for label in NIS_LABELS]}
        for one in innovations[self._written :]:
            data = [one.nis, float(len(one.y)), float(one.accepted)]
            content = self._encoder.encode(NIS, {"layout": layout, "data": data})
            self._writer.write(self._nis, content, log_time, one.stamp)
        self._written = len(innovations)


def _fill(message: NumbersMessage, estimate: FilterEstimate) -> None:
    x, y, theta = estimate.pose
    message.position[0], message.position[1] = x, y
    message.orientation[2], message.orientation[3] = quaternion_of_yaw(theta)
    fill_planar_covariance(message.pose_covariance, estimate.P)
