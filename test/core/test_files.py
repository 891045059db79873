"""Files are replaced atomically, and bags and files of others are never overwritten."""

import json
import math
import os
from pathlib import Path

import pytest

from diffbot_core.errors import DiffbotError, InvalidValueError
from diffbot_core.files import (
    MCAP,
    cache_folder,
    check_output,
    file_path,
    output_folder,
    read_text,
    replacing,
    runtime_folder,
    write_json,
    write_text,
)


def names(folder):
    return sorted(path.name for path in folder.iterdir())


def test_a_reader_sees_the_old_file_until_the_new_file_is_complete(tmp_path):
    path = tmp_path / "result.csv"
    path.write_text("old")
    with replacing(path) as part:
        part.write_text("ne")
        assert path.read_text() == "old"
        part.write_text("new")
    assert path.read_text() == "new"
    assert names(tmp_path) == ["result.csv"]


@pytest.mark.parametrize("error", [OSError("disk full"), KeyboardInterrupt()])
def test_a_failed_replacement_keeps_the_old_file_and_leaves_no_other_file(tmp_path, error):
    path = tmp_path / "result.csv"
    path.write_text("old")

    def fail(part):
        part.write_text("half")
        raise error

    with pytest.raises(type(error)), replacing(path) as part:
        fail(part)
    assert path.read_text() == "old"
    assert names(tmp_path) == ["result.csv"]


def test_a_durable_file_is_synchronised_before_it_is_renamed(tmp_path, monkeypatch):
    calls = []
    synchronise, rename = os.fsync, Path.replace

    def fsync(descriptor):
        calls.append(("fsync", os.fstat(descriptor).st_size))
        synchronise(descriptor)

    def replace(old, new):
        calls.append(("replace", os.stat(old).st_size))
        rename(old, new)

    monkeypatch.setattr(os, "fsync", fsync)
    monkeypatch.setattr(Path, "replace", replace)
    write_text(tmp_path / "state", "four", durable=True)
    assert calls == [("fsync", 4), ("replace", 4)]
    calls.clear()
    write_text(tmp_path / "state", "five!")
    assert calls == [("replace", 5)]


def test_json_contains_inf_and_nan_as_texts(tmp_path):
    write_json(tmp_path / "a.json", {"limit": math.inf, "rows": [(-math.inf, 1.5), math.nan], "count": 3})
    content = json.loads((tmp_path / "a.json").read_text())
    assert content == {"limit": "inf", "rows": [["-inf", 1.5], "nan"], "count": 3}


def test_a_full_disk_is_reported_with_the_output_folder(tmp_path):
    with pytest.raises(DiffbotError, match=r": No space left on device$"), output_folder(tmp_path / "a" / "b"):
        raise OSError(28, os.strerror(28))


def test_a_parameter_with_a_path_must_name_a_regular_or_new_file(tmp_path, monkeypatch):
    monkeypatch.setenv("HOME", str(tmp_path))
    assert file_path("state_file", "") is None
    assert file_path("state_file", "~/state.json") == tmp_path / "state.json"
    assert file_path("state_file", "state.json") == Path("state.json")
    (tmp_path / "there").touch()
    assert file_path("state_file", "~/there") == tmp_path / "there"
    os.mkfifo(tmp_path / "pipe")
    for text in (str(tmp_path), "~", "/", ".", "~nobody-of-this-name/x.json", "a\x00b", "~/pipe", "/dev/zero"):
        with pytest.raises(InvalidValueError, match=r"state_file = .* must be the path of a file"):
            file_path("state_file", text)


def test_no_file_in_a_finished_or_unfinished_bag_is_replaced(tmp_path):
    bags = tmp_path / "finished", tmp_path / "unfinished"
    for folder in bags:
        folder.mkdir()
    (bags[0] / "metadata.yaml").write_text("rosbag2_bagfile_information:\n  version: 9\n")
    (bags[0] / "one.mcap").write_bytes(MCAP)
    (bags[1] / "unfinished_0.mcap").write_bytes(MCAP)
    (tmp_path / "lone.mcap").write_bytes(MCAP + b"rest")
    (tmp_path / "link").symlink_to(bags[0])
    os.mkfifo(tmp_path / "pipe")
    paths = [bags[0] / "metadata.yaml", bags[0] / "one.mcap", bags[0] / "new", bags[1] / "unfinished_0.mcap"]
    for path in (*paths, tmp_path / "lone.mcap", tmp_path / "link" / "new", tmp_path / "pipe", bags[0]):
        before = sorted(tmp_path.rglob("*")), (tmp_path / "lone.mcap").read_bytes()
        with pytest.raises(FileExistsError):
            write_text(path, "<report/>")
        with pytest.raises(DiffbotError, match=r"cannot write|only reports are replaced"):
            check_output(path / "below" if path == bags[0] else path)
        assert (sorted(tmp_path.rglob("*")), (tmp_path / "lone.mcap").read_bytes()) == before
    for folder in bags:
        with pytest.raises(DiffbotError, match="it is a bag"), output_folder(folder):
            pass


def test_a_command_replaces_only_reports_of_diffbot(tmp_path):
    (tmp_path / "metadata.yaml").write_text("of something else")
    for name, content in (("r.xml", "<?xml?>"), ("r.html", "<!doctype html>"), ("r.json", "{}"), ("empty", "")):
        (tmp_path / name).write_text(content)
        check_output(tmp_path / name)
    check_output(tmp_path / "new" / "folder")
    (tmp_path / "notes.txt").write_text("kept")
    (tmp_path / "photo.png").write_bytes(b"\x89PNG of something else")
    (tmp_path / "link.xml").symlink_to(tmp_path / "r.xml")
    for path, inputs, words in (
        (tmp_path / "notes.txt", [], "already exists, and only reports are replaced"),
        (tmp_path / "photo.png", [], "already exists, and only reports are replaced"),
        (tmp_path / "link.xml", [], "symbolic link"),
        (tmp_path / "r.json", [tmp_path / "r.json"], "the command reads it"),
        (Path("/dev/null"), [], "neither a file nor a folder"),
    ):
        with pytest.raises(DiffbotError, match=words):
            check_output(path, inputs)


def test_a_text_is_read_only_from_a_regular_utf8_file_of_limited_size(tmp_path):
    path = tmp_path / "a.txt"
    path.write_text("höhe")
    assert read_text(path, 5) == "höhe"
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "bytes").write_bytes(b"\xff\xfe")
    for name, words in (
        ("a.txt", "is too large: must be <= 4 bytes"),
        ("pipe", "not a regular file"),
        (".", "not a regular file"),
        ("bytes", "not a text file in UTF-8"),
        ("missing", "No such file or directory"),
        ("a\0b", "not a path"),
    ):
        with pytest.raises(DiffbotError, match=words):
            read_text(tmp_path / name, 4)


def test_the_folders_of_the_user_follow_xdg_and_the_runtime_folder_has_a_fallback(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    runtime_folder.cache_clear()
    assert (cache_folder(), runtime_folder()) == (tmp_path / "cache" / "diffbot", tmp_path / "diffbot")
    assert runtime_folder().stat().st_mode & 0o777 == 0o700
    (tmp_path / "file").touch()
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path / "file"))
    runtime_folder.cache_clear()
    with pytest.raises(DiffbotError, match="cannot create the folder"):
        cache_folder()
    assert runtime_folder().is_dir()
    runtime_folder.cache_clear()
