"""Damaged and foreign bags: every command ends with a result or one line, and never changes the bag."""

import os
import struct

import bag_commands
import pytest
import yaml
from bag_makers import data_of, mcap_writing, write_folder, write_mcap
from repeated import tried

from diffbot_bag.bag import BagReader
from diffbot_core.errors import DiffbotError

NAMES = sorted(bag_commands.bag_commands() - set(bag_commands.GRAPH))


def test_every_command_on_bags_is_known():
    """A new command has to be added to ARGUMENTS, and is then tried on all bags."""
    assert bag_commands.bag_commands() == set(bag_commands.ARGUMENTS)


@pytest.fixture(scope="module")
def given(tmp_path_factory):
    return bag_commands.given_files(tmp_path_factory.mktemp("bags") / "given")


def complaints(bag, given, folder):
    """Run all commands on a bag; return the commands that end in another way than promised."""
    found = []
    files = [bag, *sorted(bag.rglob("*"))] if bag.is_dir() else [bag]
    before = [(one, one.lstat().st_size, one.lstat().st_mtime_ns) for one in files]
    for name in NAMES:
        out = folder / f"{bag.name} {name}" / "out"
        out.parent.mkdir()
        status, printed, errors = bag_commands.run(bag_commands.words_of(name, bag, given, out))
        refusals = [line for line in errors.splitlines() if "diffbot: " in line and "warning:" not in line]
        is_checked = name == "bag check" and status == 1 and printed
        if (
            status not in (0, 1, 2)
            or "Traceback" in errors
            or (status and not is_checked and (len(refusals), out.exists()) != (1, False))
            or not all(line.isprintable() for line in printed.splitlines())
        ):
            found.append((name, status, errors[-400:]))
    if [(one, one.lstat().st_size, one.lstat().st_mtime_ns) for one in files] != before:
        found.append("the bag was changed")
    return found


def whole_files(folder):
    """Yield the bytes of good files: with checksums, without checksums, and without chunks."""
    rows = bag_commands.good_rows(0.4)
    kinds = {topic: kind for topic, _, _, (kind, _) in rows}
    plain = {"compression": "none", "enable_crcs": False}
    for name, options in {"packed": {}, "plain": plain, "loose": {**plain, "use_chunking": False}}.items():
        path = folder / f"{name}.whole"
        with path.open("wb") as stream, mcap_writing(stream, kinds, chunk_size=3000, **options) as (writer, channels):
            for topic, time, sequence, message in rows:
                writer.add_message(channels[topic], time, data_of(message), time, sequence)
        yield path.read_bytes()


def mutated(rng, whole):
    """Return the bytes of a file with up to four changed numbers, and maybe without its end."""
    content = bytearray(whole)
    for _ in range(rng.randint(1, 4)):
        size = rng.choice((1, 2, 4, 8, 500))
        at = rng.randrange(8, len(content) - size)
        number = rng.choice((0, 1, 2**31, 2**63, 2**64 - 1, rng.getrandbits(64), content[at] ^ 4))
        content[at : at + size] = (number & (2 ** (8 * size) - 1)).to_bytes(size, "little")
    return bytes(content[: rng.randrange(9, len(content))] if rng.random() < 0.3 else content)


@tried(1000, once=4)
def test_commands_on_mutated_bags_end_with_a_result_or_one_line(given, trials, seeded, tmp_path):
    wholes = list(whole_files(tmp_path))
    for number in trials:
        bag = tmp_path / f"{number}.mcap"
        bag.write_bytes(mutated(seeded, wholes[number % 3]))
        assert complaints(bag, given, tmp_path) == []


def crafted(folder):
    """Yield bags that name foreign files, declare huge records, or contain control characters in names."""
    for number, name in enumerate(["/\x1b]0;x\x07\x1b[31m", "/../../tmp/x", "/a\nPASS /b", ""]):
        yield write_mcap(folder / f"topic_{number}.mcap", [(name, 5, b"\0\1\0\0")], "std_msgs/msg/Empty")
        kind = name or "x"
        yield write_mcap(folder / f"type_{number}.mcap", [("/odom", 5, bytes(9))], kind, definitions={kind: b"a b c"})
    head = b"\x89MCAP0\r\n\x01" + struct.pack("<Q", 8) + bytes(8)
    (folder / "huge_record.mcap").write_bytes(head + struct.pack("<BQ", 6, 2**62) + bytes(100))
    yield folder / "huge_record.mcap"
    os.mkfifo(folder / "pipe.mcap")
    yield folder / "pipe.mcap"
    secret = write_mcap(folder / "secret.mcap", [("/odom", 5, b"\0\1\0\0")], "std_msgs/msg/Empty")
    for name, files, yaml_text in (
        ("outside", ["../secret.mcap"], ""),
        ("absolute", [str(secret)], ""),
        ("link", ["link.mcap"], ""),
        ("code", ["code_0.mcap"], "!!python/object/apply:os.getcwd []"),
    ):
        bag = write_folder(folder / name, bag_commands.good_rows(0.1))
        (bag / "link.mcap").symlink_to(secret)
        path = bag / "metadata.yaml"
        content = yaml.safe_load(path.read_text())
        content["rosbag2_bagfile_information"]["relative_file_paths"] = files
        path.write_text(yaml_text or yaml.safe_dump(content))
        with pytest.raises(DiffbotError, match=r"is outside|is not a YAML file"):
            BagReader(bag)
        yield bag


def test_commands_on_crafted_bags_end_with_a_result_or_one_line(given, tmp_path):
    for bag in crafted(tmp_path):
        assert complaints(bag, given, tmp_path) == [], bag.name
