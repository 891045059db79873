"""Bags of unknown origin: whatever is wrong with one, it is refused in one line, in bounded time and memory."""

import os
import subprocess
import sys

import lz4.frame
import pytest
import view_bags
import yaml
import zstandard
from bag_makers import write_folder, write_mcap
from mcap.records import Chunk

from diffbot_bag.bag.reader import BagReader
from diffbot_bag.ros.conversions import message_class
from diffbot_core.bounded_yaml import load_yaml
from diffbot_core.errors import DiffbotError

POINT = "geometry_msgs/msg/Point"
MB = 2**20


def read_all(path, **limits):
    with BagReader(path, **limits) as reader:
        assert reader.topics is not None
        return list(reader.messages())


def error_of(path, **limits):
    """The line with which a bag is refused."""
    with pytest.raises(DiffbotError) as error:
        read_all(path, **limits)
    assert str(error.value).isprintable()
    assert len(str(error.value)) < 1000
    return str(error.value)


@pytest.fixture
def mcap(tmp_path):
    """Write a file with one topic and these messages, pairs of time and data."""
    path, kind = tmp_path / "foreign.mcap", "std_msgs/msg/Empty"

    def write(messages, chunk_size=MB, qos="", definition=b""):
        rows = (("/a", *message) for message in messages)
        return write_mcap(path, rows, {"/a": kind}, {"/a": qos}, definitions={kind: definition}, chunk_size=chunk_size)

    return write


BOMB = "a0: &a0 [x]\n" + "\n".join(f"a{n}: &a{n} [{', '.join([f'*a{n - 1}'] * 10)}]" for n in range(1, 12))
"""unfolds to 10^12 texts"""


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (BOMB, "has an alias"),
        ("[" * 3000 + "]" * 3000, "nested deeper than 20 levels"),
        ("#" * (5 * MB), "must be <= 4194304"),
        ("!!python/object/apply:os.getcwd []", "is not a YAML file"),
    ],
    ids=["alias", "depth", "size", "python"],
)
def test_hostile_yaml_is_refused(text, words):
    with pytest.raises(DiffbotError, match=words):
        load_yaml(text, "the text")


def test_hostile_yaml_is_refused_wherever_it_stands(tmp_path, mcap):
    assert "has an alias" in error_of(mcap([(1, b"")], qos=BOMB))
    (tmp_path / "metadata.yaml").write_text(BOMB)
    assert "has an alias" in error_of(tmp_path)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"starting_time": "now"}, "is incomplete"),
        ({"compression_mode": "FILE"}, "compression_mode = 'FILE': must be empty"),
        ({"relative_file_paths": ["link"]}, "is outside of"),
        ({"relative_file_paths": ["pipe"]}, "not a regular file"),
        ({"relative_file_paths": ["\x1b[31m\n"]}, "cannot open"),
    ],
)
def test_wrong_values_in_metadata(tmp_path, changes, words):
    folder = write_folder(tmp_path / "run", [("/a", 5, 0, view_bags.command(0.0, 0.0))])
    path = folder / "metadata.yaml"
    content = yaml.safe_load(path.read_text())
    content["rosbag2_bagfile_information"].update(changes)
    path.write_text(yaml.safe_dump(content))
    (folder / "link").symlink_to("/dev/null")
    os.mkfifo(folder / "pipe")
    assert words in error_of(folder)


UNDERSTATED = """
import resource, sys
from pathlib import Path
from diffbot_bag.bag.reader import BagReader
from diffbot_core.errors import DiffbotError
before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
for path in sys.argv[1:]:
    try:
        with BagReader(Path(path)) as reader:
            list(reader.messages())
    except DiffbotError as error:
        print(error)
print((resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) // 1024)
"""


def test_chunks_that_unpack_to_more_than_their_index_says(mcap, monkeypatch, tmp_path):
    zeros, write, paths = bytes(400 * MB), Chunk.write, []
    packed = {
        "zstd": zstandard.ZstdCompressor().compress(zeros),
        "zstd without size": zstandard.ZstdCompressor(write_content_size=False).compress(zeros),
        "lz4": lz4.frame.compress(zeros, store_size=False),
    }
    for kind, data in packed.items():

        def swapped(chunk, stream, kind=kind, data=data):
            chunk.data, chunk.compression, chunk.uncompressed_crc = data, kind[:4].strip(), 0
            write(chunk, stream)

        monkeypatch.setattr(Chunk, "write", swapped)
        paths.append(mcap([(1, b"")]).rename(tmp_path / f"{kind}.mcap"))
    ran = subprocess.run(
        [sys.executable, "-c", UNDERSTATED, *paths], capture_output=True, text=True, check=True, timeout=60
    )
    *lines, grown = ran.stdout.splitlines()
    assert ["is damaged" in line for line in lines] == [True] * 3
    assert int(grown) < 60


@pytest.mark.parametrize("read", [BagReader.messages, lambda reader: reader.rows(["/a"])])
def test_records_are_bounded_by_the_size_of_their_chunk(mcap, read):
    """A few thousand bytes may not cost the work of millions of messages, or of millions of records of zeros."""
    path = mcap([(5, b"")] * 30_000, chunk_size=64 * MB)
    assert path.stat().st_size > 16 * 30_000  # its message index, which is not packed and may be missing
    with BagReader(path) as reader, pytest.raises(DiffbotError, match=r"more than \d+ records in a chunk of \d+ bytes"):
        list(read(reader))
    path = mcap([(time, b"") for time in range(30_000)], chunk_size=64 * MB)
    with BagReader(path) as reader:
        assert sum(1 for _ in read(reader)) == 30_000


@pytest.mark.parametrize("name", ["this/x/y", "evil/msg/X", "../evil/msg/X"])
def test_a_type_name_imports_nothing_but_installed_interfaces(tmp_path, name, monkeypatch):
    (tmp_path / "evil").mkdir()
    for file in ("evil/__init__.py", "evil/msg.py"):
        (tmp_path / file).write_text(f"from pathlib import Path\nPath({str(tmp_path / 'ran')!r}).touch()\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    assert message_class(POINT)().x == 0.0
    with pytest.raises(DiffbotError) as error:
        message_class(name)
    assert "\n" not in str(error.value)
    assert not (tmp_path / "ran").exists()
    assert "this" not in sys.modules
