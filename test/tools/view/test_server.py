"""The server of the page: which connections and requests it accepts, and that slow browsers do not delay others."""

import http.client
import json
import math
import socket

import graph
import pytest
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import connect

from diffbot_core.errors import DiffbotError, InvalidValueError
from diffbot_core.geometry import Pose
from diffbot_tools.view.columns import COLUMNS
from diffbot_tools.view.events import Event
from diffbot_tools.view.live_state import LiveState
from diffbot_tools.view.requests import Request, read_request
from diffbot_tools.view.server import MAX_BAD, Address, PageServer

PATIENCE = graph.PATIENCE
GOAL = '{"type": "goal", "robot": "robot", "x": %s, "y": %s, "yaw": %s}'


@pytest.fixture
def state():
    return LiveState(["robot"])


@pytest.fixture
def requests():
    return []


@pytest.fixture
def server(state, requests):
    errors = []

    def on_request(request, reply):
        requests.append(request)
        reply("done", 0)

    running = PageServer(state, {"limits": {}}, on_request, errors.append, Address())
    running.start()
    yield running
    running.stop()
    assert errors == []


def get(server, path, **headers):
    connection = http.client.HTTPConnection("127.0.0.1", server.port, timeout=PATIENCE)
    connection.request("GET", path, headers=headers)
    answer = connection.getresponse()
    body = answer.read().decode()
    connection.close()
    return answer, body


def browse(server, token=None, origin=None, **options):
    address = f"127.0.0.1:{server.port}"
    url = f"ws://{address}/ws?token={server.token if token is None else token}"
    return connect(url, origin=origin or f"http://{address}", open_timeout=PATIENCE, compression=None, **options)


def receive(browser, kind):
    while True:
        message = json.loads(browser.recv(timeout=PATIENCE))
        if message["type"] == kind:
            return message


def test_the_page_needs_its_token(server):
    answer, body = get(server, f"/?token={server.token}")
    assert answer.status == 200
    assert '{"kind":"live"}' in body
    policy = answer.headers["Content-Security-Policy"]
    assert f"connect-src ws://127.0.0.1:{server.port};" in policy
    assert "default-src 'none'" in policy
    assert answer.headers["Referrer-Policy"] == "no-referrer"
    for path in ("/", f"/?token={server.token}x", "/?token=%00%C3%A9"):
        answer, body = get(server, path)
        assert answer.status == 403
        assert server.token not in body
    assert get(server, f"/etc/passwd?token={server.token}")[0].status == 404


def test_a_host_name_that_could_be_rebound_is_refused(server):
    for host, status in ((f"evil.example:{server.port}", 403), (f"localhost:{server.port}", 200)):
        assert get(server, f"/?token={server.token}", Host=host)[0].status == status


def test_a_foreign_page_or_a_page_without_the_token_cannot_connect(server):
    for options in ({"token": "guess"}, {"origin": "http://evil.example"}, {"origin": "null"}):
        with pytest.raises(InvalidStatus) as error:
            browse(server, **options)
        assert error.value.response.status_code == 403, options


def test_a_browser_receives_the_state_and_its_changes(server, state):
    state.put_row("robot", "estimate", (1.0, 2.0, 3.0, math.nan, *[0.1] * 4))
    state.add_events("robot", [Event(1.0, "goal", 0, "first")])
    with browse(server) as browser:
        hello = receive(browser, "hello")
        assert hello["robots"] == ["robot"]
        assert hello["columns"]["estimate"] == list(COLUMNS["estimate"])
        assert receive(browser, "history")["rows"] == [[1.0, 2.0, 3.0, None, 0.1, 0.1, 0.1, 0.1]]
        assert receive(browser, "state")["robots"]["robot"]["rows"]["estimate"][1] == 2.0
        assert receive(browser, "events")["events"] == [[1.0, "goal", 0, "first"]]
        state.put("robot", "status", {"text": "driving"})
        assert receive(browser, "state")["robots"] == {"robot": {"status": {"text": "driving"}}}
        state.add_events("robot", [Event(2.0, "end", 0, "second")])
        assert receive(browser, "events")["events"] == [[2.0, "end", 0, "second"]]


def test_a_valid_request_is_passed_on_and_answered(server, requests):
    with browse(server) as browser:
        browser.send(GOAL % (1, -2.5, 0.5))
        assert receive(browser, "answer") == {"type": "answer", "text": "done", "level": 0}
    assert requests == [Request("goal", "robot", Pose(1.0, -2.5, 0.5))]


def test_a_browser_that_sends_many_bad_requests_is_disconnected(server, requests):
    with browse(server) as browser:
        browser.send("garbage")
        assert "must be a JSON object" in receive(browser, "answer")["text"]

        def send_garbage():
            for _ in range(10 * MAX_BAD):
                browser.send(b"\x00\xff")
                browser.recv(timeout=PATIENCE)

        with pytest.raises(ConnectionClosed):
            send_garbage()
    assert requests == []
    graph.wait_for(lambda: server.browsers == 0, what="the end of the connections")


def test_a_browser_that_does_not_read_delays_no_other_and_skips_old_states(server, state):
    small = socket.create_connection(("127.0.0.1", server.port))
    small.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 2**16)

    def newest(browser):
        """Read until the last state; return the number of messages."""
        count = 1
        while not receive(browser, "state")["robots"]["robot"]["status"]["text"].startswith("2999 "):
            count += 1
        return count

    with browse(server, sock=small, max_queue=1) as slow, browse(server, max_queue=None) as quick:
        for number in range(3000):
            state.put("robot", "status", {"text": f"{number} " + 8000 * "x"})
            if number % 100 == 0:
                receive(quick, "state")
        assert newest(quick) > 0
        assert newest(slow) < 1000, "the states between were skipped"


def test_a_port_in_use_is_reported_in_one_line(server, state):
    second = PageServer(state, {}, lambda *_: None, [].append, Address(port=server.port))
    with pytest.raises(DiffbotError, match=f"cannot listen on 127.0.0.1 port {server.port}") as error:
        second.start()
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("message", "field"),
    [
        ("[" * 3000, "message"),
        ('{"type": ["goal"], "robot": "robot"}', "type"),
        (GOAL % ("NaN", 2, 0), "x"),
        (GOAL % (1, 2e7, 0), "y"),
    ],
)
def test_bad_requests_are_refused_by_field(message, field):
    with pytest.raises(InvalidValueError, match=rf"^{field}\b") as error:
        read_request(message, ["robot"])
    assert "\n" not in str(error.value)
    assert len(str(error.value)) < 200
