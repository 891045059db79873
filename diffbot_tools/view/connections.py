"""Connections of browsers: how many wait for their handshake, how long a message may take, what a message holds."""

from __future__ import annotations

import asyncio
import json
import logging
import math
from collections import deque
from typing import Any

from websockets.asyncio.server import ServerConnection

SEND_TIMEOUT = 10.0
"""[s] for a browser to take a message"""
MAX_OPENING = 64
"""connections without a complete request; of more, the oldest are closed"""
_ANSWERS = 50

Opening = dict["Connection", None]


class Connection(ServerConnection):
    """A connection, one of ``opening`` until its handshake is complete."""

    def __init__(self, opening: Opening, *arguments: Any, **options: Any) -> None:
        """Make a connection; ``opening`` belongs to the server."""
        super().__init__(*arguments, **options)
        self.opening = opening

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Begin; of too many, close the oldest."""
        super().connection_made(transport)
        self.opening[self] = None
        if len(self.opening) > MAX_OPENING:
            oldest = next(iter(self.opening))
            del self.opening[oldest]
            oldest.transport.abort()

    def connection_lost(self, exc: Exception | None) -> None:
        """End."""
        self.opening.pop(self, None)
        super().connection_lost(exc)


class Browser:
    """A connection whose handshake is complete."""

    def __init__(self, connection: ServerConnection) -> None:
        """Start without an answer."""
        self.connection = connection
        self.answers: deque[dict[str, Any]] = deque(maxlen=_ANSWERS)
        self.bad = 0

    def reply(self, text: str, level: int) -> None:
        """Queue an answer for the next message; of too many, the oldest are dropped."""
        self.answers.append({"type": "answer", "text": text, "level": level})

    async def send(self, message: Any) -> None:
        """Send a message; a browser that does not take it within SEND_TIMEOUT loses its connection."""
        try:
            await asyncio.wait_for(self.connection.send(as_json(message)), SEND_TIMEOUT)
        except asyncio.TimeoutError:
            self.connection.transport.abort()


def silent_logger() -> logging.Logger:
    """Return the logger of websockets, which would log a traceback for each client that breaks off."""
    logger = logging.getLogger(f"{__name__}.websockets")
    logger.addHandler(logging.NullHandler())
    logger.propagate = False
    return logger


def as_json(message: Any) -> str:
    """Return a message for a browser; numbers that are not finite become null.

    JSON has none: a browser would refuse the message as a whole.
    """
    try:
        return json.dumps(message, separators=(",", ":"), allow_nan=False)
    except ValueError:
        return json.dumps(_finite(message), separators=(",", ":"), allow_nan=False)


def _finite(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _finite(one) for key, one in value.items()}
    if isinstance(value, (list, tuple)):
        return [_finite(one) for one in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
