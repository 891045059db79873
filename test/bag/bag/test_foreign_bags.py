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
from mcap.exceptions import McapError
from mcap.records import Chunk, ChunkIndex

from diffbot_bag.bag.qos import load_profiles
from diffbot_bag.bag.reader import BagReader
from diffbot_bag.mcap.chunks import BagLimits, records_in
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
HOSTILE_YAML = {
    "alias": (BOMB, "has an alias"),
    "depth": ("[" * 3000 + "]" * 3000, "nested deeper than 20 levels"),
    "values": ("[" + "0," * 300_000 + "]", "more than 200000 values"),
    "size": ("#" * (5 * MB), "must be <= 4194304"),
    "digits": ("a: " + "9" * 100_000, "is not a YAML file"),
    "python": ("!!python/object/apply:os.getcwd []", "is not a YAML file"),
}


@pytest.mark.parametrize("kind", HOSTILE_YAML)
def test_hostile_yaml_is_refused(kind):
    text, words = HOSTILE_YAML[kind]
    for unique_keys in (False, True):
        with pytest.raises(DiffbotError, match=words):
            load_yaml(text, "the text", unique_keys=unique_keys)


def test_hostile_yaml_is_refused_wherever_it_stands(tmp_path, mcap):
    assert "has an alias" in error_of(mcap([(1, b"")], qos=BOMB))
    assert "QoS of 5242880 characters: must be <= " in error_of(mcap([(1, b"")], qos="#" * (5 * MB)))
    assert "is not a list of profiles" in error_of(mcap([(1, b"")], qos="5"))
    for text, words in ((BOMB, "has an alias"), ("#" * (5 * MB), "is too large"), ("- a", "has no rosbag2_bagfile_")):
        (tmp_path / "metadata.yaml").write_text(text)
        assert words in error_of(tmp_path)


@pytest.mark.parametrize(
    "profile",
    ["history: [1]", "history: often", "history: -1", "reliability: {}", "depth: -1", "depth: .inf", "depth: .nan",
     "deadline: {sec: .inf, nsec: 0}", "deadline: [1]", "avoid_ros_namespace_conventions: 5", "durability: null"],
)  # fmt: skip
def test_a_hostile_qos_profile(profile):
    with pytest.raises(DiffbotError, match="not a QoS profile"):
        load_profiles(f"- {{{profile}}}")


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"duration": {"nanoseconds": float("inf")}}, "is incomplete"),
        ({"topics_with_message_count": [5]}, "is incomplete"),
        ({"starting_time": "now"}, "is incomplete"),
        ({"storage_identifier": "x\ny" * 1000}, "must be mcap"),
        ({"compression_mode": "FILE"}, "compression_mode = 'FILE': must be empty"),
        ({"relative_file_paths": 5}, "is incomplete"),
        ({"relative_file_paths": ["run_0.mcap", "./run_0.mcap"]}, "lists a file twice"),
        ({"relative_file_paths": ["run_0.mcap"] * 1001}, "must be <= 1000"),
        ({"relative_file_paths": ["/dev/null"]}, "is outside of"),
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


def test_a_message_that_decodes_to_millions_of_objects_is_refused(mcap):
    """A list of empty messages has an object for each byte."""
    definition = b"Nothing[] all\n===\nMSG: std_msgs/Nothing\n"

    def decoded(count):
        data = b"\0\1\0\0" + count.to_bytes(4, "little") + bytes(count)
        with BagReader(mcap([(5, data)], definition=definition)) as reader:
            return list(reader.decoded())

    assert len(decoded(1000)[0].content.all) == 1000
    with pytest.raises(DiffbotError, match="has 1048577 bytes: must be <= 1048576 to be decoded"):
        decoded(MB - 7)


def test_messages_that_are_decoded_are_bounded_together(mcap):
    data = b"\0\1\0\0" + (MB - 8).to_bytes(4, "little") + bytes(MB - 8)
    path = mcap([(time, data) for time in range(1, 10)], definition=b"uint8[] all\n")
    with BagReader(path) as reader, pytest.raises(DiffbotError, match=r"to decode have more than 4\d{6} bytes"):
        list(reader.decoded())


def test_ratio_and_unpacked_size_are_bounded_by_limits(mcap):
    path = mcap([(time, bytes(MB)) for time in range(1, 81)])
    assert "max_compression_ratio = 1000 times" in error_of(path)
    found = read_all(path, limits=BagLimits(max_compression_ratio=1e6))
    assert sum(len(message.data) for message in found) == 80 * MB


def test_chunks_that_are_held_together_are_bounded(mcap):
    path = mcap([(5, os.urandom(MB)) for _ in range(4)], chunk_size=1000)
    assert "chunks that overlap in time unpack to 4194" in error_of(path, limits=BagLimits(max_unpacked_size=4 * MB))
    path = mcap([(time, os.urandom(MB)) for time in range(1, 5)], chunk_size=1000)
    assert len(read_all(path, limits=BagLimits(max_unpacked_size=2 * MB))) == 4


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


@pytest.mark.parametrize("record", [bytes(9), b"\x80" + bytes(8), b"\x0f" + bytes(8)])
def test_records_that_are_no_messages_are_bounded_too(record):
    with pytest.raises(McapError):
        list(records_in(record * MB, 5000))
    rest = list(records_in(b"\x80" + bytes(8), 5000))
    assert rest == [(0x80, 9, 9)]


def test_the_memory_for_a_small_file_is_small(mcap):
    path = mcap([(5, bytes(MB))] * 70, chunk_size=100 * MB)
    assert "chunks that overlap in time unpack to" in error_of(path, limits=BagLimits(max_compression_ratio=1e6))


def test_two_chunks_of_the_index_cannot_be_the_same_bytes(mcap, monkeypatch):
    write = ChunkIndex.write
    monkeypatch.setattr(ChunkIndex, "write", lambda index, stream: (write(index, stream), write(index, stream)))
    assert "chunks that overlap" in error_of(mcap([(1, b"")]))


@pytest.mark.parametrize("name", ["this/x/y", "evil/msg/X", "evil/X", "evil", "os.path/msg/X", "../evil/msg/X", ""])
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


def test_a_package_in_the_working_folder_does_not_replace_an_installed_one(tmp_path):
    (tmp_path / "stereo_msgs").mkdir()
    (tmp_path / "stereo_msgs" / "__init__.py").write_text("raise SystemExit('ran')")
    code = "from diffbot_bag.ros.conversions import message_class\nmessage_class('stereo_msgs/msg/DisparityImage')"
    ran = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, timeout=60, check=False
    )
    assert "type stereo_msgs/msg/DisparityImage is not installed" in ran.stderr
