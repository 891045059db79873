"""Whether the stamps of a stream of messages advance, and how late they arrive; free of ROS."""

from __future__ import annotations

import math

from diffbot_core.units import S_PER_NS

RESTART_GAP = 10**9
"""[ns] a stamp further back than this belongs to time that began anew, a closer one to a message out of order"""
_MEMORY = 2.0
"""[s] of messages, twice at most, whose least age is the usual one"""


class StampWatch:
    """Follows the stamps of one stream: a message that repeats the newest stamp is no sign of life of its sender."""

    def __init__(self) -> None:
        """Start without a stamp."""
        self.newest: int | None = None
        """[ns]"""

    def advances(self, stamp: int) -> bool:
        """Take the stamp [ns] of the newest message; return True if it is later than all before, or the first one.

        Time that has begun anew, as of a simulation that was started again, advances from the second message on.
        """
        newest = self.newest
        if newest is None or stamp > newest:
            self.newest = stamp
            return True
        if newest - stamp > RESTART_GAP:
            self.newest = stamp
        return False

    def clear(self) -> None:
        """Forget the stamps."""
        self.newest = None


class Lateness:
    """Measures how late the messages of one stream arrive, whatever the offset between its clock and the receiver's.

    A sender that was held up answers old inputs when it goes on; their stamps advance, but they are no present sign of
    life. The usual age is the least one of the last seconds of messages; silence does not make it forgotten.
    """

    def __init__(self) -> None:
        """Start without a message."""
        self._stamp = 0
        self._least = self._least_before = math.inf
        """[s] least age now, and before"""
        self._since = -math.inf
        """[s] from when on the present least age counts"""

    def next(self, stamp: int, now: float) -> float:
        """Return by how much [s] a message is older than usual at its arrival.

        Args:
            stamp: [ns] of the message; one that is earlier than the last begins time anew.
            now: [s] time of arrival on the steady clock.
        """
        age = now - stamp * S_PER_NS
        if stamp < self._stamp:
            self._least = math.inf
        if stamp < self._stamp or now - self._since > _MEMORY:
            self._least_before, self._least, self._since = self._least, age, now
        self._stamp, self._least = stamp, min(self._least, age)
        return age - min(self._least, self._least_before)
