"""Further sources of pose fixes beside ``global_pose``, each with its own topic, noise, correlation and delay."""

from __future__ import annotations

import re
from typing import Annotated, NamedTuple

from diffbot_core.errors import InvalidValueError
from diffbot_core.schema import Spec, known_fields

GLOBAL_POSE = "global_pose"
"""The first source, which is always there."""
_MAX_SOURCES = 8
_MIN_SIGMA, _MAX_SIGMA, _MAX_TIME, _MAX_DELAY = 1e-4, 1e3, 1e4, 60.0
_TOPIC_NAME = re.compile(r"[~/]?[A-Za-z_]\w*(/[A-Za-z_]\w*)*", re.ASCII)


@known_fields
class PoseSources(NamedTuple):
    """Further sources of fixes: lists with an entry per source; a list that is empty has its default for all."""

    pose_sources: Annotated[
        tuple[str, ...],
        Spec("topics of further fixes (PoseWithCovarianceStamped) beside global_pose, e.g. [gps]", read_only=True),
    ] = ()
    pose_source_sigma_xy: Annotated[
        tuple[float, ...],
        Spec(
            "per source: deviation of x and y without a usable covariance; 0, the default: drop it",
            "m",
            minimum=0.0,
            maximum=_MAX_SIGMA,
        ),
    ] = ()
    pose_source_sigma_yaw: Annotated[
        tuple[float, ...],
        Spec(
            "per source: deviation of the heading; 0, the default: drop it; pi or more: the fix has no heading",
            "rad",
            minimum=0.0,
            maximum=_MAX_SIGMA,
        ),
    ] = ()
    pose_source_correlation_time: Annotated[
        tuple[float, ...],
        Spec("per source: how long its errors last; default 0: independent", "s", minimum=0.0, maximum=_MAX_TIME),
    ] = ()
    pose_source_delay: Annotated[
        tuple[float, ...],
        Spec(
            "per source: how long before its stamp a fix was measured; default 0", "s", minimum=0.0, maximum=_MAX_DELAY
        ),
    ] = ()

    def check(self) -> None:
        """Refuse names that are no topics, and lists that do not fit together.

        Raises:
            InvalidValueError: naming the list, its value and what it has to be.
        """
        names = self.pose_sources
        if len(names) > _MAX_SOURCES or len({*names, GLOBAL_POSE}) != len(names) + 1:
            raise InvalidValueError(
                "pose_sources", list(names), f"at most {_MAX_SOURCES} different topics, not {GLOBAL_POSE}"
            )
        for name in names:
            if not _TOPIC_NAME.fullmatch(name):
                raise InvalidValueError("pose_sources", name, "the name of a topic")
        for field, values in zip(self._fields[1:], self[1:], strict=True):
            if len(values) not in (0, len(names)):
                raise InvalidValueError(field, list(values), f"empty or as many as pose_sources: {len(names)}")
        for field in ("pose_source_sigma_xy", "pose_source_sigma_yaw"):
            if any(0.0 < one < _MIN_SIGMA for one in getattr(self, field)):
                raise InvalidValueError(field, list(getattr(self, field)), f"0 or >= {_MIN_SIGMA:g} each")

    def settings(self) -> list[PoseSource]:
        """Return the settings of each source."""
        count = len(self.pose_sources)
        columns = [values or (0.0,) * count for values in self[1:]]
        return [PoseSource(*row) for row in zip(self.pose_sources, *columns, strict=True)]


class PoseSource(NamedTuple):
    """Settings of one source of fixes."""

    topic: str
    sigma_xy: float
    """[m] for fixes without a usable covariance; 0: drop them"""
    sigma_yaw: float
    """[rad] the same of the heading"""
    correlation_time: float
    """[s]"""
    delay: float
    """[s] from measuring to the stamp"""
