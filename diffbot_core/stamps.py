"""Whether the stamps of a stream of messages advance; free of ROS."""

from __future__ import annotations

RESTART_GAP = 10**9
"""[ns] a stamp further back than this belongs to time that began anew, a closer one to a message out of order"""


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
