"""Contact with the dock, from a contact switch and from the charging state of the battery."""

from __future__ import annotations


class DockContact:
    """What each source reported last; the robot touches its dock if one of them says so.

    A closed switch is contact whatever the battery reports: a docked robot may be full, or its charger may pause.
    """

    def __init__(self) -> None:
        """Start without a report."""
        self._switch_is_closed = self._has_power = False

    @property
    def touches(self) -> bool:
        """True if the switch is closed, or the charger of the dock supplies the robot."""
        return self._switch_is_closed or self._has_power

    def on_switch(self, is_closed: bool) -> None:
        """Remember the state of the switch."""
        self._switch_is_closed = is_closed

    def on_charger(self, has_power: bool | None) -> None:
        """Remember if the dock supplies the robot; None, the battery does not know, keeps what it reported before."""
        if has_power is not None:
            self._has_power = has_power
