"""Pose fixes: PoseWithCovarianceStamped on ``global_pose`` and on the topics of further sources."""

from __future__ import annotations

from typing import Any

from diffbot_control.filter.measurements import FIXES, PoseFix, Source
from diffbot_control.filter.measurements.fix import fix_of, further_source
from diffbot_control.filter.pose_sources import GLOBAL_POSE
from diffbot_control.ros.messages.fields import check_frame, planar_covariance, pose_of, stamp_ns
from diffbot_control.ros.parameters.ekf import EkfNodeConfig
from diffbot_control.ros.sensors.noise import MESSAGE_NOISE, KnownNoise, diagonal, noise_of
from diffbot_control.ros.sensors.sensor import Reading
from diffbot_core.units import S_PER_NS

POSE_MESSAGE = "geometry_msgs/msg/PoseWithCovarianceStamped"


class FixSensor:
    """One source of fixes; a fix whose heading has a deviation of pi or more is one of the position alone."""

    message_type = POSE_MESSAGE

    def __init__(self, topic: str, source: Source, noise: KnownNoise, frame: str, delay: float) -> None:
        """Describe the source.

        Args:
            topic: of its messages.
            source: its name at the filter.
            noise: fallback covariance.
            frame: of its poses.
            delay: [s] from measuring to the stamp.
        """
        self.topic, self._source, self._noise, self._frame = topic, source, noise, frame
        self._delay = round(delay / S_PER_NS)

    def read(self, message: Any) -> Reading:
        """Return the fix of a message."""
        fix = fix_from(message, self._frame, self._noise)
        return Reading([fix_of(fix.stamp - self._delay, fix.pose, fix.R, self._source)], fix.R is self._noise.R)


def fix_sensors(config: EkfNodeConfig) -> list[FixSensor]:
    """Return ``global_pose`` and the further sources."""
    noise, frame = config.noise, config.map_frame
    first = global_pose_noise(config)
    further = [
        FixSensor(
            one.topic,
            further_source(one.topic),
            KnownNoise(diagonal((one.sigma_xy, one.sigma_xy, one.sigma_yaw)), noise.override_covariance),
            frame,
            one.delay,
        )
        for one in config.localization.sources.settings()
    ]
    return [FixSensor(GLOBAL_POSE, Source(FIXES), first, frame, 0.0), *further]


def global_pose_noise(config: EkfNodeConfig) -> KnownNoise:
    """Return the fallback covariance of ``global_pose``, and of ``initialpose``."""
    xy, yaw = config.noise.global_pose_sigma_xy, config.noise.global_pose_sigma_yaw
    return KnownNoise(diagonal((xy, xy, yaw)), config.noise.override_covariance)


def fix_from(message: Any, frame: str, noise: KnownNoise = MESSAGE_NOISE) -> PoseFix:
    """Return the pose fix of a PoseWithCovarianceStamped in ``frame``; for its covariance see :func:`noise_of`."""
    check_frame(message.header.frame_id, frame)
    pose = pose_of(message.pose.pose)
    R = noise_of(lambda: planar_covariance(message.pose.covariance), noise)
    return PoseFix(stamp_ns(message.header.stamp), pose, R)
