"""Configuration of the fusion: the filter, the noise of the odometry, further sources of fixes."""

from __future__ import annotations

from typing import Annotated, NamedTuple

from diffbot_control.filter.measurements import FIXES, HEADINGS, LANDMARKS
from diffbot_control.filter.measurements.fix import further_source
from diffbot_control.filter.odometry_noise import OdometryConfig
from diffbot_control.filter.options import FNN, FNN_CALIBRATING, FilterConfig
from diffbot_control.filter.pose_sources import PoseSources
from diffbot_core.errors import InvalidValueError
from diffbot_core.schema import Spec, known_fields


@known_fields
class LocalizationConfig(NamedTuple):
    """Options of the fusion."""

    history_length: Annotated[float, Spec("how late a measurement may come", "s", minimum=0.0, maximum=60.0)] = 1.0
    filter: FilterConfig = FilterConfig()
    odometry: OdometryConfig = OdometryConfig()
    sources: PoseSources = PoseSources()

    def check(self) -> None:
        """Refuse further sources of fixes that the filter cannot use.

        Raises:
            InvalidValueError: if the filter learns one R for all fixes, or a delay is longer than the history.
        """
        sources = self.sources
        if sources.pose_sources and self.filter.filter in (FNN, FNN_CALIBRATING):
            raise InvalidValueError(
                "pose_sources", list(sources.pose_sources), f"empty with {self.filter.filter}: it learns one R"
            )
        if any(delay > self.history_length for delay in sources.pose_source_delay):
            raise InvalidValueError(
                "pose_source_delay",
                list(sources.pose_source_delay),
                f"<= history_length: {self.history_length:g}",
            )

    def correlation_times(self) -> dict[str, float]:
        """Return how long errors last [s], by the names of the sensors; those of others are independent."""
        config = self.filter
        return {
            HEADINGS: config.heading_correlation_time,
            LANDMARKS: config.landmark_correlation_time,
            FIXES: config.fix_correlation_time,
        } | {further_source(one.topic).sensor: one.correlation_time for one in self.sources.settings()}
