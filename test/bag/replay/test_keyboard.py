"""Keys of a terminal: decoding in any pieces, and the modes of the terminal."""

import os
import termios

import pytest

from diffbot_bag.replay import keyboard
from diffbot_bag.replay.keyboard import FASTER, NEXT, SLOWER, TOGGLE, KeyDecoder, open_keyboard


def decoded(*pieces):
    decoder = KeyDecoder()
    return [key for piece in pieces for key in decoder.feed(piece)]


def test_keys_are_found_whole_and_in_pieces():
    text = b" \x1b[C\x1b[A\x1b[B\x1bOC\x1bOA\x1bOB "
    expected = [TOGGLE, NEXT, FASTER, SLOWER, NEXT, FASTER, SLOWER, TOGGLE]
    for size in (1, 2, 3, len(text)):
        assert decoded(*(text[index : index + size] for index in range(0, len(text), size))) == expected


@pytest.mark.parametrize("text", [b"abc", b"\x1b", b"\x1b[", b"\x1b[D", b"\x1b[1;5C", b"\x1b[Z", b"\xff\x00", b"[C"])
def test_other_input_is_ignored_and_spoils_nothing(text):
    assert decoded(text) == []
    assert decoded(text, b"\x1b[A") == [FASTER]
    assert decoded(text, b" ")[-1:] == [TOGGLE]


def test_keys_arrive_at_once_until_the_terminal_is_restored(terminal, monkeypatch):
    ours, theirs = terminal
    before = termios.tcgetattr(theirs)
    # A terminal of others: to read it would stop this process.
    assert open_keyboard(theirs) is None
    monkeypatch.setattr(keyboard, "in_foreground", lambda _: True)
    keys = open_keyboard(theirs)
    assert keys.pressed() == []
    # As a shell does that had the terminal meanwhile.
    termios.tcsetattr(theirs, termios.TCSANOW, before)
    assert keys.pressed() == []
    assert termios.tcgetattr(theirs)[3] & (termios.ICANON | termios.ECHO) == 0
    os.write(ours, b" \x1b[A")
    assert keys.pressed() == [TOGGLE, FASTER]
    keys.close()
    assert termios.tcgetattr(theirs) == before
