"""Steps of the odometry, and its dead time: a twist acts later than its stamp says, as that of a command does."""

from __future__ import annotations

from typing import NamedTuple

from diffbot_core.kinematics import Twist, TwistCovariance


class OdometryStep(NamedTuple):
    """Mean twist since the odometry before."""

    stamp: int
    """[ns] end of the interval"""
    twist: Twist
    covariance: TwistCovariance


class Piece(NamedTuple):
    """Part of a time with one twist."""

    odometry: OdometryStep
    """the twist that acts, stamped with the end of the part"""
    whole: int
    """[ns] duration of the message that it comes from"""


class DelayLine:
    """The newest odometry messages, and which of them acts when.

    A message stamped t that follows one stamped s is the mean twist over (s, t]; delayed by d, over (s + d, t + d].
    Before the first message acts, its twist is assumed.
    """

    def __init__(self) -> None:
        """Start empty."""
        self._messages: list[tuple[int, OdometryStep]] = []

    def clear(self) -> None:
        """Forget all messages."""
        self._messages.clear()

    def pieces(self, start: int, odometry: OdometryStep, delay: int) -> list[Piece]:
        """Add a message, and return what moves the robot from ``start`` to its stamp.

        Args:
            start: [ns] stamp of the message before.
            odometry: the new message.
            delay: [ns] >= 0.
        """
        self._messages.append((start, odometry))
        found: list[Piece] = []
        for began, message in self._messages:
            end = min(message.stamp + delay, odometry.stamp)
            if end > start:
                found.append(Piece(message._replace(stamp=end), message.stamp - began))
                start = end
        # What has acted to its end is over; at least the newest message stays.
        self._messages = [one for one in self._messages if one[1].stamp + delay > odometry.stamp] or self._messages[-1:]
        return found
