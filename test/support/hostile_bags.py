"""Bags that somebody made to do harm, and bags that were damaged at random."""

import contextlib
import os
import random
import struct

import view_bags
import yaml
from bag_makers import BEGIN, data_of, mcap_writing, qos, write_folder, write_mcap
from damaged_bags import damage, original
from mcap.writer import IndexType

MB = 2**20
EVIL = [
    "/\x1b]0;x\x07\x1b[31m",
    "/../../../../tmp/x",
    "/a\nPASS /b",
    "/" + "n" * 65_536,
    "",
    "/\u202egnp\u2066",
    "/%s{}\\",
]
"""Names of topics and types."""
WITHOUT_INDEX = {"index_types": IndexType.CHUNK | IndexType.ATTACHMENT | IndexType.METADATA}


def good_rows(seconds=1.0):
    """Topic, log time, sequence, (type, message) of a robot on a circle: all that the commands read."""
    rows = []
    for number in range(int(seconds * 20)):
        time = BEGIN + number * 50_000_000
        x, y, yaw = 0.02 * number, 0.01 * number, 0.02 * number
        rows += [
            ("/odom", time, number, view_bags.odometry(time, x, y, yaw, frame="odom")),
            ("/global_pose", time + 1, number, view_bags.estimate(time, x, y, yaw)),
            ("/pose", time + 2, number, view_bags.estimate(time, x, y, yaw)),
            ("/ground_truth", time + 3, number, view_bags.odometry(time, x, y, yaw)),
            ("/cmd_vel", time + 4, number, view_bags.command(0.2, 0.1)),
        ]
        if number % 5 == 0:
            rows += [
                ("/ekf/status", time + 5, number, view_bags.status("ekf", "running", **{"NIS per number": "1.0"})),
                ("/rosout", time + 6, number, view_bags.log(time, "ekf", "text")),
                ("/tf", time + 7, number, view_bags.transforms(time, ("map", "odom", 0.0, 0.0, 0.0))),
                ("/plan", time + 8, number, view_bags.path(time, (0.0, 0.0), (1.0, 1.0))),
                ("/goal_pose", time + 9, number, view_bags.goal(time, 1.0, 1.0, 0.5)),
            ]
    return rows


def seeds(folder):
    """Return bytes of good files to mutate: packed with checksums; and plain without any, so that bits reach far."""
    found = []
    for name, options in {
        "packed": {"compression": "zstd"},
        "plain": {"compression": "none", "enable_crcs": False, "enable_data_crcs": False},
        "no chunks": {"compression": "none", "enable_crcs": False, "use_chunking": False},
    }.items():
        path = folder / f"{name}.mcap"
        rows = good_rows(0.4)
        # Profiles of some only: they are most of the work on so small a bag.
        offers = dict.fromkeys(("/odom", "/tf"), qos())
        kinds = {topic: kind for topic, _, _, (kind, _) in rows}
        with (
            path.open("wb") as stream,
            mcap_writing(stream, kinds, offers, chunk_size=3000, **options) as (writer, channels),
        ):
            for topic, time, sequence, message in rows:
                writer.add_message(channels[topic], time, data_of(message), time, sequence)
            writer.add_attachment(5, 6, "parameters.json", "application/json", b'{"/controller": {"preset": "tuned"}}')
        found.append(original(path.read_bytes()))
    return found


def mutated(rng, whole):
    """Return the bytes of a good file, damaged: cut, flipped, zeroed, or with other numbers in the place of some."""
    if rng.random() < 0.5:
        return damage(whole, rng)[0]
    content = bytearray(whole.content)
    for _ in range(rng.randint(1, 4)):
        size = rng.choice((1, 2, 4, 8))
        at = rng.randrange(8, len(content) - size)
        number = rng.choice((0, 1, 2**31 - 1, 2**31, 2**62 + 1, 2**63, 2**64 - 1, rng.getrandbits(64)))
        content[at : at + size] = (number & (2 ** (8 * size) - 1)).to_bytes(size, "little")
    if rng.random() < 0.2:
        begin, end = sorted(rng.randrange(8, len(content)) for _ in range(2))
        at = rng.randrange(8, len(content))
        content[at:at] = content[begin:end]
    return bytes(content)


def _file(path, messages, kind="std_msgs/msg/Empty", topics=("/a",), text=b"", **options):
    """Write a file of (topic, time, data) with a schema of any text."""
    return write_mcap(path, messages, dict.fromkeys(topics, kind), definitions={kind: text}, **options)


def small_and_huge(folder):
    """Write files below 1 MB that unpack to much, or are much work."""
    from mcap.records import Chunk

    whole = dict(chunk_size=1 << 40, **WITHOUT_INDEX)
    yield _file(folder / "empty_messages.mcap", (("/a", 5, b"") for _ in range(1_000_000)), **whole)
    yield _file(folder / "indexed.mcap", [("/a", number, b"") for number in range(50_000)], chunk_size=100_000)
    yield _file(folder / "large_message.mcap", [("/a", 5, bytes(400 * MB))], **whole)
    yield _file(folder / "large_messages.mcap", ((("/a", n, bytes(MB))) for n in range(60)), chunk_size=MB)
    write = Chunk.write
    for name, record in {"zeros": bytes(9), "private": b"\x80" + bytes(8), "schemas": b"\x03" + bytes(8)}.items():
        data = record * (60 * MB // len(record))

        def swapped(chunk, stream, data=data):
            import zstandard

            chunk.data, chunk.compression = zstandard.compress(data), "zstd"
            chunk.uncompressed_crc, chunk.uncompressed_size = 0, len(data)
            write(chunk, stream)

        Chunk.write = swapped
        try:
            path = _file(folder / f"{name}.mcap", [("/a", 5, b"")], chunk_size=1)
        finally:
            Chunk.write = write
        # Without its end the file has no index, and all of it is searched.
        path.write_bytes(path.read_bytes()[:-30])
        yield path
    magic = b"\x89MCAP0\r\n"
    header = b"\x01" + struct.pack("<Q", 8) + bytes(8)
    for name, content in {
        "file_of_zeros": bytes(MB),
        "file_of_records": (b"\x80" + bytes(8)) * (MB // 9),
        "file_of_bad_records": (b"\x05" + bytes(8) + b"\x80" + bytes(8)) * (MB // 18),
        "file_of_heads": struct.pack("<BQQQQI", 6, 0, 1, 2, 60 * MB, 1) * (MB // 41),
        "file_of_noise": random.Random(1).randbytes(MB),
    }.items():
        path = folder / f"{name}.mcap"
        path.write_bytes(magic + header + content)
        yield path
    yield _file(folder / "many_topics.mcap", [], topics=[f"/t{number}" for number in range(9_000)])


def evil_names(folder):
    """Write bags with topics, types and texts that do harm where they are printed or used as paths."""
    for number, name in enumerate(EVIL):
        yield _file(folder / f"topic_{number}.mcap", [(name, 5, b"\0\1\0\0")], topics=[name])
        yield _file(folder / f"type_{number}.mcap", [("/odom", 5, b"\0\1\0\0")], kind=name or "x", topics=["/odom"])
    kinds = {"/rosout": "std_msgs/msg/Empty", "/odom": "x", "/global_pose": "x", "/tf": "x", "/ekf/status": "x"}
    for topic, kind in kinds.items():
        yield _file(folder / f"other_type{topic.replace('/', '_')}.mcap", [(topic, 5, b"\0\1\0\0" * 9)], kind, [topic])
    for number, name in enumerate(["../secret.mcap", "/etc/passwd", "a\nb.mcap", "\x1b[31m.mcap", "n" * 5000]):
        bag = folder / f"named_{number}"
        write_folder(bag, good_rows(0.2))
        path = bag / "metadata.yaml"
        content = yaml.safe_load(path.read_text())
        content["rosbag2_bagfile_information"]["relative_file_paths"] = [name]
        path.write_text(yaml.safe_dump(content))
        yield bag


def extreme_values(folder):
    """Write bags of the types that are read, with numbers at the ends of their ranges in the place of each."""
    rng = random.Random(4)
    special = [struct.pack("<d", one) for one in (float("nan"), float("inf"), 1e308, -1e308, 5e-324)]
    special += [bytes(8), b"\xff" * 8, b"\xff\xff\xff\x7f" * 2]
    for number in range(8):
        path = folder / f"extreme_{number}.mcap"
        rows = good_rows(0.5)
        kinds = {topic: kind for topic, _, _, (kind, _) in rows}
        messages = []
        for topic, time, sequence, message in rows:
            data = bytearray(data_of(message))
            for _ in range(number):
                at = 4 + 4 * rng.randrange((len(data) - 4) // 4)
                data[at : at + 8] = rng.choice(special)[: len(data) - at]
            messages.append((topic, time, bytes(data), time, sequence))
        write_mcap(path, messages, kinds)
        yield path


def odd_files(folder):
    """Write links, pipes, folders and files without permission in the places of a bag and its parts."""
    good = write_folder(folder / "whole", good_rows(0.5))
    content = (good / "whole_0.mcap").read_bytes()
    os.mkfifo(folder / "pipe.mcap")
    yield folder / "pipe.mcap"
    for name, target in {"gone.mcap": "nowhere", "loop.mcap": "loop.mcap", "device.mcap": "/dev/zero"}.items():
        (folder / name).symlink_to(target)
        yield folder / name
    for name, make in {
        "with_pipe": os.mkfifo,
        "with_link": lambda path: path.symlink_to("/etc/passwd"),
        "with_folder": lambda path: path.mkdir(),
        "with_empty": lambda path: path.touch(),
        "without_permission": lambda path: (path.write_bytes(content), path.chmod(0)),
    }.items():
        (folder / name).mkdir()
        make(folder / name / "a_0.mcap")
        yield folder / name
        (folder / f"{name}_metadata").mkdir()
        (folder / f"{name}_metadata" / "a_0.mcap").write_bytes(content)
        with contextlib.suppress(OSError):
            make(folder / f"{name}_metadata" / "metadata.yaml")
        yield folder / f"{name}_metadata"
    (folder / "empty").mkdir()
    yield folder / "empty"
    yield folder / "missing"


def crafted(folder, *, full=True):
    """Write bags that are made on purpose, and yield their paths; not ``full``: without what takes seconds to read."""
    for kind in (small_and_huge, evil_names, extreme_values, odd_files)[0 if full else 1 :]:
        (folder / kind.__name__).mkdir()
        yield from kind(folder / kind.__name__)


def given_files(folder, contract, parameters):
    """Write what the commands are given besides a bag."""
    folder.mkdir()
    (folder / "contract.yaml").write_text(contract)
    (folder / "ekf.yaml").write_text(parameters)
    for name in ("good", "other"):
        write_folder(folder / name, good_rows(0.5))
    return folder
