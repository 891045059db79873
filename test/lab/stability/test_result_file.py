"""Packed arrays come back as they were, and no packed text fills the memory."""

import tracemalloc

import pytest

from diffbot_core.errors import DiffbotError
from diffbot_lab.stability.result_file import pack, unpack


def test_a_bomb_is_not_unpacked():
    bomb = pack(bytes(10**8))
    tracemalloc.start()
    try:
        with pytest.raises(DiffbotError, match="must hold 10 bytes"):
            unpack("ranks", bomb, 10)
        assert tracemalloc.get_traced_memory()[1] < 10**6
    finally:
        tracemalloc.stop()
