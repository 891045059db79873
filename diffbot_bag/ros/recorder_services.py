"""Services of the recorder, by the names of rosbag2, as far as std_srvs/Trigger can carry them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from std_srvs.srv import Trigger

from diffbot_bag.recording.recording import Recording
from diffbot_bag.writer import BagWriteError, BagWriter

Answer = tuple[bool, str]


def offer_services(
    node: Any,
    writer: BagWriter,
    recording: Recording,
    fail: Callable[[BagWriteError], None],
    changed: Callable[[], None],
) -> None:
    """Offer ``~/split_bagfile``, ``~/snapshot``, ``~/pause``, ``~/resume`` and ``~/is_paused``.

    Args:
        node: the recorder.
        writer: of the bag.
        recording: what is paused, or has messages in memory.
        fail: called when the bag cannot be written.
        changed: called after each service.
    """

    def split() -> Answer:
        name = writer.path.name
        return (True, f"{name} is complete") if writer.split() else (False, f"{name} has no message yet")

    def pause() -> Answer:
        recording.is_paused = True
        return True, "paused"

    def resume() -> Answer:
        recording.is_paused = False
        return True, "recording"

    def is_paused() -> Answer:
        return True, "paused" if recording.is_paused else "recording"

    def answering(action: Callable[[], Answer]) -> Callable[[Any, Any], Any]:
        def answer(_request: Any, response: Any) -> Any:
            if writer.closed:
                response.success, response.message = False, "the bag is closed"
                return response
            try:
                response.success, response.message = action()
            except BagWriteError as error:
                response.success, response.message = False, str(error)
                fail(error)
            changed()
            return response

        return answer

    actions: dict[str, Callable[[], Answer]] = {
        "split_bagfile": split,
        "snapshot": recording.take_snapshot,
        "pause": pause,
        "resume": resume,
        "is_paused": is_paused,
    }
    for name, action in actions.items():
        node.create_service(Trigger, f"~/{name}", answering(action))
