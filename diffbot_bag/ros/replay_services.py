"""Services of a replay: as Triggers under the node's name and, where rosbag2_interfaces exists, those of rosbag2.

A Trigger carries no argument: seek, set_rate and burst are parameters instead, see ReplayConfig. rosbag2's services
have the names at which its own player offers them, ``rosbag2_player/...``, so that its clients find them.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from std_srvs.srv import Trigger

from diffbot_bag.parameters import MAX_BURST, MAX_RATE, MIN_RATE
from diffbot_bag.replay.playback_clock import SECOND
from diffbot_bag.replay.player import Player
from diffbot_bag.ros.replay_control import ReplayControl
from diffbot_core.ros.node import DiffbotNode

PLAYER_NAME = "rosbag2_player"
"""Name of rosbag2's node"""
ROSBAG2_SERVICES = (
    "burst", "get_rate", "is_paused", "pause", "play_next", "resume", "seek", "set_rate", "stop", "toggle_paused",
)  # fmt: skip
"""Names of those that rosbag2_interfaces defines"""


class ReplayServices:
    """All services of one replay."""

    def __init__(
        self, node: DiffbotNode[Any], player: Player, control: ReplayControl, changed: Callable[[], None]
    ) -> None:
        """Create them; ``changed`` is called after each."""
        self._node, self._player, self._control, self._changed = node, player, control, changed
        self._offer_triggers()
        try:
            from rosbag2_interfaces import srv  # noqa: PLC0415 - no wheel contains it
        except ImportError:
            return
        self.offer_rosbag2(srv)

    def _offer_triggers(self) -> None:
        player = self._player

        def pause() -> tuple[bool, str]:
            player.pause()
            return True, "paused"

        def resume() -> tuple[bool, str]:
            player.resume()
            return True, "playing"

        def stop() -> tuple[bool, str]:
            self._control.end()
            return True, "stopped"

        def play_next() -> tuple[bool, str]:
            sent = bool(player.step())
            return sent, "one message sent" if sent else "not paused, or no message left"

        triggers: dict[str, Callable[[], tuple[bool, str]]] = {
            "pause": pause,
            "resume": resume,
            "toggle_paused": lambda: (True, _state(player.toggle_paused())),
            "is_paused": lambda: (True, _state(player.progress().is_paused)),
            "get_rate": lambda: (True, f"{player.progress().rate:g}"),
            "stop": stop,
            "play_next": play_next,
        }
        for name, action in triggers.items():
            self._node.create_service(Trigger, f"~/{name}", self._answering(action))

    def _answering(self, action: Callable[[], tuple[bool, str]]) -> Callable[[Any, Any], Any]:
        def answer(_request: Any, response: Any) -> Any:
            response.success, response.message = action()
            self._changed()
            return response

        return answer

    def offer_rosbag2(self, types: Any) -> None:
        """Offer the services of rosbag2's player; ``types`` is the module rosbag2_interfaces.srv."""
        player, control = self._player, self._control
        # Name, type, and what the response gets: fields by name, {} for an empty response.
        services: dict[str, tuple[Any, Callable[[Any], dict[str, Any]]]] = {
            "pause": (types.Pause, _nothing_after(player.pause)),
            "resume": (types.Resume, _nothing_after(player.resume)),
            "toggle_paused": (types.TogglePaused, _nothing_after(player.toggle_paused)),
            "is_paused": (types.IsPaused, lambda _: {"paused": player.progress().is_paused}),
            "get_rate": (types.GetRate, lambda _: {"rate": player.progress().rate}),
            "set_rate": (types.SetRate, lambda request: {"success": self._set_rate(request.rate)}),
            "play_next": (types.PlayNext, lambda _: {"success": bool(player.step())}),
            "burst": (types.Burst, lambda request: {"actually_burst": self._burst(request.num_messages)}),
            "seek": (types.Seek, lambda request: {"success": control.seek(_nanoseconds(request.time))}),
            "stop": (types.Stop, _nothing_after(control.end)),
        }
        for name, (kind, action) in services.items():
            self._node.create_service(kind, f"{PLAYER_NAME}/{name}", self._filling(action))

    def _filling(self, action: Callable[[Any], dict[str, Any]]) -> Callable[[Any, Any], Any]:
        def answer(request: Any, response: Any) -> Any:
            for field, value in action(request).items():
                setattr(response, field, value)
            self._changed()
            return response

        return answer

    def _set_rate(self, rate: float) -> bool:
        return MIN_RATE <= rate <= MAX_RATE and self._control.set_rate(rate)

    def _burst(self, count: int) -> int:
        return self._player.step(min(count, MAX_BURST) or MAX_BURST)


def _state(is_paused: bool) -> str:
    return "paused" if is_paused else "playing"


def _nothing_after(action: Callable[[], object]) -> Callable[[Any], dict[str, Any]]:
    """Return a function that calls ``action`` and has nothing for the response."""

    def call(_request: Any) -> dict[str, Any]:
        action()
        return {}

    return call


def _nanoseconds(time: Any) -> int:
    return int(time.sec) * SECOND + int(time.nanosec)
