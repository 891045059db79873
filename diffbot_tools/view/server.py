"""Serves the page and its WebSocket to browsers, in a thread of its own.

Whoever may send goals to a robot has to be the user: the address carries a token, the Host and Origin headers have to
be those of this server (a foreign page in the same browser has another origin, a rebound name another host), and
whatever a browser sends is small and checked. A browser that is slow gets the newest state when it is ready for it.
"""

from __future__ import annotations

import asyncio
import hmac
import ipaddress
import json
import secrets
import socket
import threading
import urllib.parse
from collections import deque
from collections.abc import Callable
from http import HTTPStatus
from typing import Any, NamedTuple

from websockets.asyncio.server import Server, ServerConnection, serve
from websockets.datastructures import Headers
from websockets.exceptions import ConnectionClosed
from websockets.http11 import Request as HttpRequest
from websockets.http11 import Response

from diffbot_core.errors import DiffbotError, InvalidValueError
from diffbot_tools.view.intake import MAX_MESSAGE, Request, read_request
from diffbot_tools.view.live_state import COLUMNS, LiveState
from diffbot_tools.view.page_file import html, policy

PERIOD = 0.05
"""[s] between two messages to a browser: 20 Hz"""
REQUEST_PERIOD = 0.02
"""[s] between two requests of a browser that are read"""
MAX_BROWSERS = 16
MAX_BAD = 20
"""bad requests after which a browser is disconnected"""
_ANSWERS = 50
_START_TIMEOUT = 10.0

Reply = Callable[[str, int], None]
"""Takes a text for the browser and its level, 0 to 2; may be called from any thread."""


class Address(NamedTuple):
    """Where the server listens."""

    host: str = "127.0.0.1"
    port: int = 0
    """0: a free one"""


class _Browser:
    """A connection."""

    def __init__(self, connection: ServerConnection) -> None:
        self.connection = connection
        self.answers: deque[dict[str, Any]] = deque(maxlen=_ANSWERS)
        self.bad = 0

    def reply(self, text: str, level: int) -> None:
        """Queue an answer for the next message; of too many, the oldest are dropped."""
        self.answers.append({"type": "answer", "text": text, "level": level})


class PageServer:
    """The server; :meth:`start` and :meth:`stop` are for the thread that made it."""

    def __init__(
        self,
        state: LiveState,
        constants: dict[str, Any],
        on_request: Callable[[Request, Reply], None],
        address: Address,
    ) -> None:
        """Prepare the page; nothing listens yet.

        Args:
            state: what the browsers are shown.
            constants: tolerances and limits until others are known.
            on_request: called in the server's thread with each checked request; must return at once.
            address: where to listen.
        """
        self._state, self._constants, self._on_request, self._address = state, constants, on_request, address
        self.token = secrets.token_urlsafe(18)
        self.port = 0
        self._browsers: set[_Browser] = set()
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._run, name="page server", daemon=True)
        self._started = threading.Event()
        self._failure: OSError | None = None
        self._end: asyncio.Event | None = None

    @property
    def url(self) -> str:
        """The address with the token."""
        host = self._address.host if self._address.host not in ("0.0.0.0", "::", "") else "127.0.0.1"
        host = f"[{host}]" if ":" in host else host
        return f"http://{host}:{self.port}/?token={self.token}"

    @property
    def browsers(self) -> int:
        """Number of connected browsers."""
        return len(self._browsers)

    def start(self) -> None:
        """Listen.

        Raises:
            DiffbotError: if the address cannot be used.
        """
        self._thread.start()
        if not self._started.wait(_START_TIMEOUT):
            raise DiffbotError("the page server did not start")
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
        try:
            self._loop.run_until_complete(self._serve())
        except OSError as error:
            self._failure = error
        finally:
            self._started.set()
            self._loop.close()

    async def _serve(self) -> None:
        self._end = asyncio.Event()
        server: Server = await serve(
            self._converse,
            self._address.host,
            self._address.port,
            process_request=self._answer_http,
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
        """Return the page, or a refusal; None lets the WebSocket begin."""
        url = urllib.parse.urlsplit(request.path)
        host = _single(request.headers, "Host")
        if (refusal := self._refusal(url, host, _single(request.headers, "Origin"))) is not None:
            return connection.respond(*refusal)
        return None if url.path == "/ws" else self._page(host)

    def _refusal(self, url: urllib.parse.SplitResult, host: str, origin: str) -> tuple[HTTPStatus, str] | None:
        """Return why a request is refused, None if it is not."""
        tokens = urllib.parse.parse_qs(url.query).get("token", [""])
        if not self._is_own_host(host):
            return HTTPStatus.FORBIDDEN, "wrong Host\n"
        if not hmac.compare_digest(tokens[0].encode(), self.token.encode()):
            return HTTPStatus.FORBIDDEN, "The address lacks its token: use the one that diffbot prints.\n"
        if url.path not in ("/", "/ws"):
            return HTTPStatus.NOT_FOUND, "no such page\n"
        if url.path == "/ws" and origin != f"http://{host}":
            return HTTPStatus.FORBIDDEN, "wrong Origin\n"
        if len(self._browsers) >= MAX_BROWSERS:
            return HTTPStatus.SERVICE_UNAVAILABLE, "too many browsers\n"
        return None

    def _is_own_host(self, host: str) -> bool:
        """Return whether a Host header names this server by a number or as localhost: no other name can be trusted."""
        name, _, port = host.rpartition(":")
        if port != str(self.port):
            return False
        if name in ("localhost", self._address.host, socket.gethostname()):
            return True
        try:
            ipaddress.ip_address(name.strip("[]"))
        except ValueError:
            return False
        return True

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
        browser = _Browser(connection)
        self._browsers.add(browser)
        sender = asyncio.ensure_future(self._send(browser))
        try:
            async for text in connection:
                self._receive(browser, text)
                if browser.bad > MAX_BAD:
                    await connection.close(1008, "too many bad requests")
                await asyncio.sleep(REQUEST_PERIOD)
        except ConnectionClosed:
            pass
        finally:
            sender.cancel()
            self._browsers.discard(browser)

    async def _send(self, browser: _Browser) -> None:
        """Send the newest state whenever the browser has taken the one before, at most every PERIOD."""
        send = browser.connection.send
        hello = {"type": "hello", "robots": self._state.robots, "columns": COLUMNS, "constants": self._constants}
        version = 0
        try:
            for message in (hello, *self._state.history()):
                await send(_json(message))
            while True:
                state, events, version = self._state.news(version)
                if state:
                    await send(_json(state))
                for robot, many in events.items():
                    await send(_json({"type": "events", "robot": robot, "events": many}))
                while browser.answers:
                    await send(_json(browser.answers.popleft()))
                await asyncio.sleep(PERIOD)
        except ConnectionClosed:
            pass
        except ValueError:  # a number that JSON does not have; without an end, the page would wait for ever
            await browser.connection.close(1011, "the state cannot be sent")

    def _receive(self, browser: _Browser, text: str | bytes) -> None:
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


def _json(message: dict[str, Any]) -> str:
    return json.dumps(message, separators=(",", ":"), allow_nan=False)
