"""Packed arrays come back as they were, and no packed text fills the memory."""

import base64
import tracemalloc
import zlib

import pytest

from diffbot_core.errors import DiffbotError
from diffbot_lab.stability.result_file import pack, unpack


def test_what_is_packed_is_unpacked_and_readable_by_other_tools():
    raw = bytes(range(256)) * 50
    assert unpack("ranks", pack(raw), len(raw)) == raw
    assert zlib.decompress(base64.b64decode(pack(raw))) == raw


@pytest.mark.parametrize("size", [9, 11])
def test_another_size_is_refused_by_name(size):
    with pytest.raises(DiffbotError, match=f"ranks: must hold {size} bytes"):
        unpack("ranks", pack(bytes(10)), size)


def test_a_bomb_is_not_unpacked():
    bomb = pack(bytes(10**8))
    tracemalloc.start()
    try:
        with pytest.raises(DiffbotError, match="must hold 10 bytes"):
            unpack("ranks", bomb, 10)
        assert tracemalloc.get_traced_memory()[1] < 10**6
    finally:
        tracemalloc.stop()
