"""Folders of one user: closed to others, and not used if somebody else owns them or could have written to them."""

import os
import stat

import pytest

from diffbot_core.errors import DiffbotError
from diffbot_core.foreign_files import read_own
from diffbot_core.private_folders import private_folder, runtime_folder

OPEN = (0o770, 0o777, 0o702)


def mode_of(path):
    return stat.S_IMODE(path.lstat().st_mode)


@pytest.fixture(autouse=True)
def fresh():
    runtime_folder.cache_clear()
    yield
    runtime_folder.cache_clear()


def test_a_folder_is_made_for_its_user_alone_whatever_the_umask_and_closed_where_others_could_read_it(tmp_path):
    before = os.umask(0)
    try:
        made = private_folder(tmp_path / "a" / "b")
    finally:
        os.umask(before)
    (tmp_path / "cache").mkdir(mode=0o755)
    assert mode_of(made) == mode_of(private_folder(tmp_path / "cache")) == 0o700


@pytest.mark.parametrize(
    ("make", "reason"),
    [
        *((lambda path, mode=mode: path.mkdir() or path.chmod(mode), f"its mode 0{mode:o} lets") for mode in OPEN),
        (lambda path: path.symlink_to("."), "it is no folder"),
        (lambda path: path.touch(), "File exists"),
    ],
)
def test_what_others_can_write_to_or_is_no_folder_is_not_used_and_left_as_it_is(tmp_path, make, reason):
    path = tmp_path / "cache"
    make(path)
    before = path.lstat().st_mode
    with pytest.raises(DiffbotError, match=f"{path} is not used: {reason}"):
        private_folder(path)
    assert path.lstat().st_mode == before


def test_folders_and_files_of_another_user_are_not_used(tmp_path, monkeypatch):
    folder, file = private_folder(tmp_path / "cache"), tmp_path / "state.json"
    file.touch(mode=0o600)
    monkeypatch.setattr(os, "geteuid", lambda: os.getuid() + 1)
    for use in (lambda: private_folder(folder), lambda: read_own(file, 10)):
        with pytest.raises(DiffbotError, match=rf"it belongs to user {os.getuid()}, this is user {os.getuid() + 1}"):
            use()


def test_the_folder_of_running_programs_is_the_sessions(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    assert runtime_folder() == tmp_path / "diffbot"


@pytest.mark.parametrize("variable", ["XDG_RUNTIME_DIR", "XDG_CACHE_HOME"])
def test_where_the_folder_of_running_programs_is_open_to_others_it_is_a_new_one(
    tmp_path, monkeypatch, caplog, variable
):
    monkeypatch.delenv("XDG_RUNTIME_DIR", raising=False)
    monkeypatch.setenv(variable, str(tmp_path))
    folder = tmp_path / "diffbot"
    folder.mkdir()
    folder.chmod(0o777)
    made = runtime_folder()
    assert mode_of(made) == 0o700
    assert not made.is_relative_to(tmp_path)
    assert [one.startswith(f"{folder} is not used: its mode 0777") for one in caplog.messages] == [True]
