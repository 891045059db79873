"""Serves the page and its WebSocket to browsers, in a thread of its own.

Only the user may send goals to a robot. Therefore the address contains a token, and the headers Host and Origin must
name this server. A foreign page in the same browser has another Origin, and a DNS name that was rebound to this machine
is another Host. Requests are small and are checked. A slow browser skips states and receives the newest one. If a
browser does not receive, or if serving it fails, only its own connection is closed.
"""

from __future__ import annotations

import asyncio
import hmac
import ipaddress
import json
import logging
import math
import secrets
import socket
import threading
import urllib.parse
from collections import deque
from collections.abc import Callable, Coroutine
from functools import partial
from http import HTTPStatus
from typing import Any, NamedTuple

from websockets.asyncio.server import Server, ServerConnection, serve
from websockets.datastructures import Headers
from websockets.exceptions import ConnectionClosed
from websockets.http11 import Request as HttpRequest
from websockets.http11 import Response

from diffbot_core.errors import DiffbotError, InvalidValueError
from diffbot_tools.view.columns import COLUMNS
from diffbot_tools.view.live_state import LiveState
from diffbot_tools.view.page_file import html, policy
from diffbot_tools.view.requests import MAX_MESSAGE, Request, read_request

PERIOD = 1.0 / 30.0
"""[s] Shortest time between two states that are sent to a browser."""
REQUEST_PERIOD = 0.02
"""[s] Shortest time between two requests that are read from a browser."""
OPEN_TIMEOUT = 5.0
"""[s] After this time, a connection without a complete request is closed."""
MAX_BROWSERS = 16
MAX_BAD = 20
"""A browser that sends more bad requests is disconnected."""
_START_TIMEOUT = 10.0
SEND_TIMEOUT = 10.0
"""[s] After this time, a browser that does not receive a message is disconnected."""
MAX_OPENING = 64
"""Number of connections without a complete request. If there are more, the oldest is closed."""
_ANSWERS = 50
"""Number of answers that wait for a browser."""

Reply = Callable[[str, int], None]
"""Sends a text with a level from 0 to 2 to the browser; may be called from any thread."""
Opening = dict["Connection", None]
"""Connections without a complete request, the oldest first."""


class Address(NamedTuple):
    """Where the server listens."""

    host: str = "127.0.0.1"
    port: int = 0
    """0 chooses a free port"""


class Connection(ServerConnection):
    """A connection, which is in ``opening`` until its handshake is complete."""

    def __init__(self, opening: Opening, *arguments: Any, **options: Any) -> None:
        """Create a connection; all connections of a server share ``opening``."""
        super().__init__(*arguments, **options)
        self.opening = opening

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Add the connection to ``opening``; if there are more than MAX_OPENING, close the oldest."""
        super().connection_made(transport)
        self.opening[self] = None
        if len(self.opening) > MAX_OPENING:
            oldest = next(iter(self.opening))
            del self.opening[oldest]
            oldest.transport.abort()

    def connection_lost(self, exc: Exception | None) -> None:
        """Remove the connection from ``opening``."""
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
        """Queue an answer; when the queue is full, drop the oldest answer."""
        self.answers.append({"type": "answer", "text": text, "level": level})

    async def send(self, message: Any) -> None:
        """Send a message. If the browser does not receive it within SEND_TIMEOUT, close the connection."""
        try:
            await asyncio.wait_for(self.connection.send(as_json(message)), SEND_TIMEOUT)
        except asyncio.TimeoutError:
            self.connection.transport.abort()


class PageServer:
    """The server; call :meth:`start` and :meth:`stop` from one thread."""

    def __init__(
        self,
        state: LiveState,
        constants: dict[str, Any],
        on_request: Callable[[Request, Reply], None],
        on_error: Callable[[Exception], None],
        address: Address,
    ) -> None:
        """Prepare the server, which does not listen yet.

        Args:
            state: state of the robots.
            constants: tolerances and limits until those of the robot are known, see constants.py.
            on_request: called in the server's thread with each valid request; must return at once.
            on_error: called in the server's thread with each unexpected exception; the server continues.
            address: address to listen on.
        """
        self._state, self._constants, self._address = state, constants, address
        self._on_request, self._on_error = on_request, on_error
        self.token = secrets.token_urlsafe(18)
        self.port = 0
        self._browsers: set[Browser] = set()
        self._opening: Opening = {}
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._run, name="page server", daemon=True)
        self._started = threading.Event()
        self._failure: OSError | None = None
        self._end: asyncio.Event | None = None

    @property
    def url(self) -> str:
        """The address of the page, with the token."""
        host = self._address.host if self._address.host not in ("0.0.0.0", "::", "") else "127.0.0.1"
        host = f"[{host}]" if ":" in host else host
        return f"http://{host}:{self.port}/?token={self.token}"

    @property
    def browsers(self) -> int:
        """Number of connected browsers."""
        return len(self._browsers)

    def start(self) -> None:
        """Start to listen.

        Raises:
            DiffbotError: if the address cannot be used.
        """
        self._thread.start()
        if not self._started.wait(_START_TIMEOUT):
            raise DiffbotError(f"the server of the page did not start within {_START_TIMEOUT:g} s")
        if self._failure is not None:
            host, port = self._address
            raise DiffbotError(f"cannot listen on {host} port {port}: {self._failure.strerror or self._failure}")

    def stop(self) -> None:
        """Close all connections and end the thread."""
        if self._end is not None and self._thread.is_alive():
            self._loop.call_soon_threadsafe(self._end.set)
            self._thread.join(timeout=5.0)

    def _run(self) -> None:
        asyncio.set_event_loop(self._loop)
        self._loop.set_exception_handler(self._contain)
        try:
            self._loop.run_until_complete(self._serve())
        except OSError as error:
            self._failure = error
        finally:
            self._started.set()
            self._loop.close()

    def _contain(self, _loop: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
        error = context.get("exception")
        self._on_error(error if isinstance(error, Exception) else DiffbotError(context["message"]))

    async def _serve(self) -> None:
        self._end = asyncio.Event()
        server: Server = await serve(
            self._converse,
            self._address.host,
            self._address.port,
            process_request=self._answer_http,
            create_connection=partial(Connection, self._opening),  # type: ignore[arg-type] # only ever called
            logger=_silent_logger(),
            open_timeout=OPEN_TIMEOUT,
            compression=None,
            max_size=MAX_MESSAGE,
            max_queue=4,
            write_limit=2**16,
            close_timeout=1.0,
        )
        async with server:
            self.port = next(iter(server.sockets)).getsockname()[1]
            self._started.set()
            await self._end.wait()

    def _answer_http(self, connection: ServerConnection, request: HttpRequest) -> Response | None:
        """Return the page or a refusal; return None to start the WebSocket."""
        try:
            url = urllib.parse.urlsplit(request.path)
            host = _single(request.headers, "Host")
            if (refusal := self._refusal(url, host, _single(request.headers, "Origin"))) is not None:
                return connection.respond(*refusal)
            return None if url.path == "/ws" else self._page(host)
        except ValueError:  # the path is not a valid address
            return connection.respond(HTTPStatus.BAD_REQUEST, "bad request\n")
        except Exception as error:
            self._on_error(error)
            return connection.respond(HTTPStatus.INTERNAL_SERVER_ERROR, "internal error\n")

    def _refusal(self, url: urllib.parse.SplitResult, host: str, origin: str) -> tuple[HTTPStatus, str] | None:
        """Return status and text of a refusal; None if the request is allowed."""
        tokens = urllib.parse.parse_qs(url.query).get("token", [""])
        if not self._is_own_host(host):
            return HTTPStatus.FORBIDDEN, "wrong Host\n"
        if not hmac.compare_digest(tokens[0].encode(), self.token.encode()):
            return (
                HTTPStatus.FORBIDDEN,
                "The token in the address is missing or wrong: open the address that diffbot prints.\n",
            )
        if url.path not in ("/", "/ws"):
            return HTTPStatus.NOT_FOUND, "no such page\n"
        if url.path == "/ws" and origin != f"http://{host}":
            return HTTPStatus.FORBIDDEN, "wrong Origin\n"
        if len(self._browsers) >= MAX_BROWSERS:
            return HTTPStatus.SERVICE_UNAVAILABLE, "too many browsers\n"
        return None

    def _is_own_host(self, host: str) -> bool:
        """Return True if a Host header names this server by an IP address, its host name or localhost.

        Any other name could have been rebound to this machine by a foreign page.
        """
        name, _, port = host.rpartition(":")
        if port != str(self.port):
            return False
        if name in ("localhost", self._address.host, socket.gethostname()):
            return True
        try:
            # The page contains the host. After a %, an address may contain any text as the name of an interface.
            return "%" not in name and bool(ipaddress.ip_address(name.strip("[]")))
        except ValueError:
            return False

    def _page(self, host: str) -> Response:
        connect = f"ws://{host}"
        body = html({"kind": "live"}, connect).encode("utf-8")
        headers = Headers(
            {
                "Content-Type": "text/html; charset=utf-8",
                "Content-Length": str(len(body)),
                "Content-Security-Policy": policy(connect) + "; frame-ancestors 'none'",
                "X-Content-Type-Options": "nosniff",
                "Referrer-Policy": "no-referrer",
                "Cache-Control": "no-store",
                "Connection": "close",
            }
        )
        return Response(HTTPStatus.OK, "OK", headers, body)

    async def _converse(self, connection: ServerConnection) -> None:
        if isinstance(connection, Connection):
            connection.opening.pop(connection, None)
        browser = Browser(connection)
        self._browsers.add(browser)
        sender = asyncio.ensure_future(self._guard(browser, self._send(browser)))
        try:
            await self._guard(browser, self._receive_all(browser))
        finally:
            sender.cancel()
            self._browsers.discard(browser)

    async def _guard(self, browser: Browser, work: Coroutine[Any, Any, None]) -> None:
        """Send or receive; an exception ends only this connection."""
        try:
            await work
        except ConnectionClosed:
            pass
        except Exception as error:
            self._on_error(error)
            # The page connects again when its connection is closed. It would wait on an open connection.
            await browser.connection.close(1011, "internal error")

    async def _receive_all(self, browser: Browser) -> None:
        async for text in browser.connection:
            self._receive(browser, text)
            if browser.bad > MAX_BAD:
                await browser.connection.close(1008, "too many bad requests")
            await asyncio.sleep(REQUEST_PERIOD)

    async def _send(self, browser: Browser) -> None:
        """Send the changes of the state, at most every PERIOD, and after the browser has received the previous ones."""
        hello = {"type": "hello", "robots": self._state.robots, "columns": COLUMNS, "constants": self._constants}
        version = 0
        for message in (hello, *self._state.history()):
            await browser.send(message)
        while True:
            state, events, version = self._state.changes_since(version)
            if state:
                await browser.send(state)
            for robot, many in events.items():
                await browser.send({"type": "events", "robot": robot, "events": many})
            while browser.answers:
                await browser.send(browser.answers.popleft())
            await asyncio.sleep(PERIOD)

    def _receive(self, browser: Browser, text: str | bytes) -> None:
        try:
            request = read_request(text, self._state.robots)
        except InvalidValueError as error:
            browser.bad += 1
            browser.reply(f"refused: {error}", 2)
            return
        self._on_request(request, browser.reply)


def _single(headers: Headers, name: str) -> str:
    found = headers.get_all(name)
    return found[0] if len(found) == 1 else ""


def _silent_logger() -> logging.Logger:
    """Return a logger without output, since websockets logs a traceback for each client that disconnects early."""
    logger = logging.getLogger(f"{__name__}.websockets")
    logger.addHandler(logging.NullHandler())
    logger.propagate = False
    return logger


def as_json(message: Any) -> str:
    """Return a message as JSON, with null for numbers that are not finite, since a browser cannot read NaN."""
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
