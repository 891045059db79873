"""Control of a running replay by its parameters ``rate``, ``seek`` and ``burst``, and by the keys of a terminal."""

from __future__ import annotations

import threading
from typing import Any

from rcl_interfaces.msg import SetParametersResult
from rclpy.parameter import Parameter

from diffbot_bag.parameters import MAX_RATE, MIN_RATE, ReplayConfig
from diffbot_bag.replay import keyboard
from diffbot_bag.replay.playback_clock import SECOND, Window, nanoseconds
from diffbot_bag.replay.player import Player
from diffbot_core.errors import DiffbotError, InvalidValueError
from diffbot_core.ros.node import DiffbotNode

KEY_PERIOD = 0.05
"""[s] between two looks at the keyboard"""


class ReplayControl:
    """Passes changes of parameters and keys on to the player."""

    def __init__(
        self,
        node: DiffbotNode[ReplayConfig],
        player: Player,
        origin: int,
        window: Window,
        ending: threading.Event,
    ) -> None:
        """Obey the parameters as they are now, and each change from now on.

        Args:
            node: the replay.
            player: its player.
            origin: log time [ns] from which ``seek`` counts.
            window: part of the bag that is played.
            ending: set by :meth:`end`.

        Raises:
            InvalidValueError: if ``seek`` or ``burst`` is not allowed at the start.
        """
        self._node, self._player, self._ending = node, player, ending
        self._origin, self._window = origin, window
        self._keyboard: keyboard.Keyboard | None = None
        config = node.config
        if config.seek >= 0.0:
            player.seek(self._time_of(config.seek))
        if config.burst and not player.request_steps(config.burst):
            raise InvalidValueError("burst", config.burst, "0, unless start_paused is true")
        node.add_on_set_parameters_callback(self._check)
        node.add_post_set_parameters_callback(self._apply)

    def use_keyboard(self) -> None:
        """Obey keys, if stdin is a terminal."""
        self._keyboard = keyboard.open_keyboard()
        if self._keyboard:
            self._node.get_logger().info(keyboard.HELP)
            self._node.create_timer(KEY_PERIOD, self._obey_keys, clock=self._node.steady_clock)

    def close(self) -> None:
        """Restore the terminal."""
        if self._keyboard:
            self._keyboard.close()

    def seek(self, time: int) -> bool:
        """Jump to a log time [ns]; return False if it is not in the window, or the replay has ended."""
        return self._window.start <= time <= self._window.end and self._player.seek(time)

    def set_rate(self, rate: float) -> bool:
        """Change the parameter ``rate``; return False if that is not allowed."""
        return bool(self._node.set_parameters([Parameter("rate", value=rate)])[0].successful)

    def end(self) -> None:
        """End the replay."""
        self._ending.set()
        self._player.stop()

    def _time_of(self, seek: float) -> int:
        """Return the log time [ns] of a value of the parameter ``seek``."""
        time = self._origin + nanoseconds(seek)
        if not self._window.start <= time <= self._window.end:
            low, high = ((bound - self._origin) / SECOND for bound in self._window)
            raise InvalidValueError("seek", seek, f">= {low:.9g} s and <= {high:.9g} s, the part that is played")
        return time

    def _check(self, changes: list[Any]) -> SetParametersResult:
        values = {change.name: change.value for change in changes}
        config = self._node.config
        try:
            if values.get("seek", -1.0) >= 0.0:
                self._time_of(values["seek"])
            if values.get("burst", 0) and not self._player.progress().is_paused:
                raise InvalidValueError("burst", values["burst"], "set while the replay is paused")
            if config.as_fast_as_possible and values.get("rate", config.rate) != config.rate:
                raise InvalidValueError("rate", values["rate"], "left alone with as_fast_as_possible")
        except DiffbotError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    def _apply(self, changes: list[Any]) -> None:
        # By their values: rclpy calls the callback added last first, so that the node's config may be the old one.
        for change in changes:
            if change.name == "rate" and not self._node.config.as_fast_as_possible:
                self._player.set_rate(change.value)
            elif change.name == "seek" and change.value >= 0.0:
                self._player.seek(self._time_of(change.value))
            elif change.name == "burst" and change.value:
                self._player.request_steps(change.value)

    def _obey_keys(self) -> None:
        config = self._node.config
        for key in self._keyboard.pressed() if self._keyboard else ():
            if key == keyboard.TOGGLE:
                self._node.get_logger().info("paused" if self._player.toggle_paused() else "playing")
            elif key == keyboard.NEXT:
                self._player.request_steps(1)
            elif not config.as_fast_as_possible:
                self._change_rate(1.0 + (keyboard.RATE_STEP if key == keyboard.FASTER else -keyboard.RATE_STEP))

    def _change_rate(self, factor: float) -> None:
        self.set_rate(min(max(self._node.config.rate * factor, MIN_RATE), MAX_RATE))
        self._node.get_logger().info(f"rate {self._node.config.rate:.3g}")
