"""Hostile bytes for connections to a page server, from a seed."""

from websockets.frames import Frame, Opcode

GOAL = '{"type": "goal", "robot": "robot", "x": %s, "y": 0, "yaw": 0}'
MESSAGES = [
    *(GOAL % value for value in ("NaN", "1e400", "-Infinity", "1" + "0" * 3000, '"1,5"', "null", "[[]]", "true")),
    "[" * 3000,
    '{"a":' * 700,
    "x" * 100_000,
    '{"type": {}, "robot": []}',
    '{"type": "record", "robot": "robot", "on": 1e999}',
    '{"type": "pause", "robot": "\\ud800"}',
    "\x00",
    "",
]


def requests(host, token):
    """Return functions that make the bytes of a request from a random generator, by kind."""
    head = f"Host: {host}\r\n"
    upgrade = (
        f"{head}Origin: http://{host}\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
        "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\nSec-WebSocket-Version: 13\r\n\r\n"
    )
    page = f"GET /?token={token} HTTP/1.1\r\n"

    def get(target, rest=head):
        return f"GET {target} HTTP/1.1\r\n{rest}\r\n".encode("latin-1")

    def socket(rng, data):
        return f"GET /ws?token={token} HTTP/1.1\r\n{upgrade}".encode() + data

    return {
        "nothing": lambda rng: b"",
        "half a request": lambda rng: get(f"/?token={token}")[: rng.randrange(1, 40)],
        "header of 1 MB": lambda rng: f"{page}X: {'a' * 1_000_000}".encode(),
        "many headers": lambda rng: (page + 5000 * "X: a\r\n" + "\r\n").encode(),
        "noise": lambda rng: rng.randbytes(rng.randrange(1, 3000)) + b"\r\n\r\n",
        "bad address": lambda rng: get(
            rng.choice(["//[", "//]:99999", "http://[::1", "/?token=\xff", "*", "\xff\x00"])
        ),
        "bad escapes": lambda rng: get(f"/?token=%{rng.choice(['', 'zz', 'f', '00', 'C3%28', 'ud800'])}"),
        "body": lambda rng: f"POST /?token={token} HTTP/1.1\r\n{head}Content-Length: 9{'9' * 300}\r\n\r\nNaN".encode(),
        "never reads": lambda rng: socket(rng, b""),
        "wrong frames": lambda rng: socket(rng, rng.randbytes(rng.randrange(1, 500))),
        "unmasked": lambda rng: socket(rng, b"\x81\x02{}"),
        "length that lies": lambda rng: socket(rng, b"\x81\xff" + rng.randbytes(12)),
        "fragments": lambda rng: socket(
            rng, frame(b"[", is_last=False) + b"".join(frame(b"[", Opcode.CONT, is_last=False) for _ in range(2999))
        ),
        "pings": lambda rng: socket(rng, b"".join(frame(b"x" * 100, Opcode.PING) for _ in range(300))),
        "messages": lambda rng: socket(
            rng, b"".join(frame(one.encode("utf-8", "replace")) for one in rng.sample(MESSAGES, 3))
        ),
        "binary": lambda rng: socket(rng, frame(rng.randbytes(50), Opcode.BINARY)),
    }


def frame(payload, kind=Opcode.TEXT, *, is_last=True):
    """Return a frame as a browser sends it."""
    return Frame(kind, payload, fin=is_last).serialize(mask=True)
