"""``diffbot bag repair``: what it prints, and its status."""

import damaged_bags
import pytest

from diffbot_bag.bag.reader import BagReader
from diffbot_tools.cli import main


@pytest.fixture(scope="module")
def whole():
    return damaged_bags.original(damaged_bags.mcap_file(count=900))


def run(capsys, *arguments):
    status = main(["bag", "repair", *map(str, arguments)])
    output = capsys.readouterr()
    return status, output.out.splitlines(), output.err


def test_what_is_lost_is_printed(tmp_path, capsys, whole):
    source = tmp_path / "run.mcap"
    content = bytearray(whole.content)
    begin, end, messages = whole.chunks[3]
    content[(begin + end) // 2] ^= 1
    source.write_bytes(content)
    status, lines, _ = run(capsys, source, tmp_path / "fixed")
    assert status == 0
    left = 900 - messages.total()
    times = sorted((time - damaged_bags.BEGIN) / 1e9 for _, time, *_ in messages)
    by_topic = ", ".join(
        f"{topic} {sum(count for (name, *_), count in messages.items() if name == topic)}"
        for topic in damaged_bags.TOPICS
    )
    assert lines == [
        f"{tmp_path / 'fixed'}: {left} messages of 3 topics in 0.899 s",
        f"run.mcap: lost: 1 damaged chunk, {end - begin} bytes that cannot be read",
        f"run.mcap: lost: {messages.total()} messages ({by_topic})",
        f"run.mcap: lost: messages between {times[0]:.3f} s and {times[-1]:.3f} s",
    ]
    assert main(["bag", "repair", str(source), str(tmp_path / "fixed")]) == 1
    assert capsys.readouterr().err.count("\n") == 1


def test_a_file_without_its_end_loses_nothing_of_what_was_written(tmp_path, capsys, whole):
    source = tmp_path / "run.mcap"
    source.write_bytes(whole.content[:-3000])
    status, lines, _ = run(capsys, source, "--in-place")
    assert status == 0
    assert lines[0].startswith(f"{source}: 900 messages")
    assert lines[1:] == [
        "run.mcap: had no valid index, since it was cut off, not finished or damaged at its end",
        "nothing that was written is lost",
    ]
    with BagReader(source) as reader:
        assert reader.message_count == 900
