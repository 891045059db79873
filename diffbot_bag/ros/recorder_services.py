"""Services of the recorder, by the names of rosbag2, as far as std_srvs/Trigger can carry them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from std_srvs.srv import Trigger

from diffbot_bag.bag.writer import BagWriteError, BagWriter
from diffbot_bag.record.recording import Recording

Answer = tuple[bool, str]


class RecorderServices:
    """Offers ``~/split_bagfile``, ``~/pause``, ``~/resume`` and ``~/is_paused``."""

    def __init__(
        self,
        node: Any,
        writer: BagWriter,
        recording: Recording,
        fail: Callable[[BagWriteError], None],
        changed: Callable[[], None],
    ) -> None:
        """Offer the services.

        Args:
            node: the recorder.
            writer: of the bag.
            recording: is paused and resumed.
            fail: called when the bag cannot be written.
            changed: called after each service.
        """
        self._writer, self._recording, self._fail, self._changed = writer, recording, fail, changed
        for name, action in (
            ("split_bagfile", self._split),
            ("pause", lambda: self._pause(True)),
            ("resume", lambda: self._pause(False)),
            ("is_paused", self._is_paused),
        ):
            node.create_service(Trigger, f"~/{name}", self._answering(action))

    def _split(self) -> Answer:
        name = self._writer.path.name
        return (True, f"{name} is complete") if self._writer.split() else (False, f"{name} has no message yet")

    def _pause(self, paused: bool) -> Answer:
        self._recording.is_paused = paused
        return self._is_paused()

    def _is_paused(self) -> Answer:
        return True, "paused" if self._recording.is_paused else "recording"

    def _answering(self, action: Callable[[], Answer]) -> Callable[[Any, Any], Any]:
        def answer(_request: Any, response: Any) -> Any:
            if self._writer.closed:
                response.success, response.message = False, "the bag is closed"
                return response
            try:
                response.success, response.message = action()
            except BagWriteError as error:
                response.success, response.message = False, str(error)
                self._fail(error)
            self._changed()
            return response

        return answer
