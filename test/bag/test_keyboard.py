"""Keys of a terminal: decoding in any pieces, and a terminal that is as before, whatever ends the process."""

import os
import sys
import termios

import graph
import pytest
from terminals import in_terminal

from diffbot_bag.keyboard import FASTER, NEXT, SLOWER, TOGGLE, KeyDecoder, open_keyboard


def decoded(*pieces):
    decoder = KeyDecoder()
    return [key for piece in pieces for key in decoder.feed(piece)]


def test_keys_are_found_whole_and_in_pieces():
    text = b" \x1b[C\x1b[A\x1b[B\x1bOC\x1bOA\x1bOB "
    expected = [TOGGLE, NEXT, FASTER, SLOWER, NEXT, FASTER, SLOWER, TOGGLE]
    assert decoded(text) == expected
    assert decoded(*(text[index : index + 1] for index in range(len(text)))) == expected
    assert decoded(text[:2], text[2:6], text[6:]) == expected


@pytest.mark.parametrize("text", [b"abc", b"\x1b", b"\x1b[", b"\x1b[D", b"\x1b[1;5C", b"\x1b[Z", b"\xff\x00", b"[C"])
def test_other_input_is_ignored_and_spoils_nothing(text):
    assert decoded(text) == []
    assert decoded(text, b"\x1b[A") == [FASTER]
    assert decoded(text, b" ")[-1:] == [TOGGLE]


PROGRAM = """
import sys, time
from diffbot_bag.keyboard import open_keyboard
keyboard = open_keyboard()
print("keys" if keyboard else "none", flush=True)
deadline = time.monotonic() + 20.0
pressed = []
while keyboard and len(pressed) < 2 and time.monotonic() < deadline:
    pressed += keyboard.pressed()
    time.sleep(0.01)
print(pressed, flush=True)
END
"""


@pytest.mark.parametrize(
    ("end", "status"), [("keyboard.close()", 0), ("", 0), ("sys.exit(3)", 3), ("raise RuntimeError", 1)]
)
def test_the_terminal_is_restored_whatever_ends_the_process(terminal, end, status):
    ours, theirs = terminal
    before = termios.tcgetattr(theirs)
    with graph.process(sys.executable, "-c", PROGRAM.replace("END", end), **in_terminal(theirs)) as running:
        running.wait_for_output("keys")
        assert termios.tcgetattr(theirs)[3] & (termios.ICANON | termios.ECHO) == 0
        os.write(ours, b" \x1b[A")
        assert running.wait() == status
        assert f"['{TOGGLE}', '{FASTER}']" in running.output
    assert termios.tcgetattr(theirs) == before


def test_keys_arrive_again_after_a_shell_has_changed_the_terminal(terminal):
    ours, theirs = terminal
    before = termios.tcgetattr(theirs)
    with graph.process(sys.executable, "-c", PROGRAM.replace("END", ""), **in_terminal(theirs)) as running:
        running.wait_for_output("keys")
        termios.tcsetattr(theirs, termios.TCSANOW, before)
        graph.wait_for(lambda: termios.tcgetattr(theirs)[3] & termios.ICANON == 0, what="keys without an Enter")
        os.write(ours, b"  ")
        assert running.wait() == 0
        assert f"['{TOGGLE}', '{TOGGLE}']" in running.output
    assert termios.tcgetattr(theirs) == before


def test_without_a_terminal_there_is_no_keyboard(tmp_path, terminal):
    with (tmp_path / "file").open("w") as file:
        assert open_keyboard(file.fileno()) is None
    # A terminal of others: to read it would stop this process.
    assert open_keyboard(terminal[1]) is None
    assert open_keyboard(-1) is None
