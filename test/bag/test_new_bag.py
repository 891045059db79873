"""A bag appears whole or not at all."""

import pytest

from diffbot_bag.new_bag import new_bag
from diffbot_bag.reader import BagReader
from diffbot_bag.writer import BagWriteError

STRING = "std_msgs/msg/String"


def test_bag_and_files_beside_it_appear_together(tmp_path):
    with new_bag(tmp_path / "run") as writer:
        channel = writer.add_topic("/text", STRING)
        writer.write(channel, b"\0\1\0\0\2\0\0\0a\0\0\0", 5, 5)
        (writer.folder / "notes.txt").write_text("x")
        assert not (tmp_path / "run").exists()
    assert sorted(one.name for one in (tmp_path / "run").iterdir()) == ["metadata.yaml", "notes.txt", "run_0.mcap"]
    with BagReader(tmp_path / "run") as reader:
        assert reader.message_count == 1
    assert [one.name for one in tmp_path.iterdir()] == ["run"]


def test_failure_leaves_nothing(tmp_path):
    def write():
        with new_bag(tmp_path / "run") as writer:
            writer.add_topic("/text", STRING)
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        write()
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("kind", ["folder", "file", "broken link"])
def test_existing_name_is_refused_and_left_alone(tmp_path, kind):
    path = tmp_path / "run"
    {"folder": path.mkdir, "file": path.touch, "broken link": lambda: path.symlink_to("nowhere")}[kind]()
    with pytest.raises(BagWriteError, match="exists already"), new_bag(path):
        pass
    assert [one.name for one in tmp_path.iterdir()] == ["run"]
