"""Entry points of plug-ins, and a hash that changes with all code that produces a result."""

import sys
from importlib.metadata import version

import pytest

from diffbot_core.errors import DiffbotError
from diffbot_core.installed import DISTRIBUTION, entry_points_by_name, hash_of_code, install_hint


def test_the_pip_command_names_the_installed_distribution():
    assert version(DISTRIBUTION)
    assert install_hint("pandas") == "pip install 'diffbot-ros[pandas]'"


def test_the_first_of_two_entry_points_with_the_same_name_is_used(tmp_path, monkeypatch):
    folder = tmp_path / "diffbot-0.0.9.dist-info"
    folder.mkdir()
    (folder / "METADATA").write_text("Metadata-Version: 2.1\nName: diffbot\nVersion: 0.0.9\n")
    (folder / "entry_points.txt").write_text("[diffbot.commands]\ncampaign = earlier:add\nearlier = earlier:add\n")
    own = entry_points_by_name("diffbot.commands")
    assert list(own) == sorted(own)
    assert own["campaign"].value.startswith("diffbot_lab.")
    with monkeypatch.context() as patch:
        patch.syspath_prepend(str(tmp_path))
        found = entry_points_by_name("diffbot.commands")
        assert set(found) == {*own, "earlier"}
        assert found["campaign"].value == "earlier:add"
    monkeypatch.setattr(sys, "path", [*sys.path, str(tmp_path)])
    assert entry_points_by_name("diffbot.commands")["campaign"] == own["campaign"]


def test_every_change_of_code_python_or_a_library_changes_the_hash(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(str(tmp_path))
    package = tmp_path / "hashed_package"
    (package / "part").mkdir(parents=True)
    for name, text in {"__init__": "", "a": "x = 1\n", "b": "y = 2\n", "part/c": "z = 3\n"}.items():
        (package / f"{name}.py").write_text(text)

    def found():
        return hash_of_code(["hashed_package"], ["numpy"])

    hashes = [found()]
    assert found() == hashes[0]
    (package / "part" / "new.py").write_text("")
    hashes.append(found())
    (package / "part" / "new.py").rename(package / "new.py")
    hashes.append(found())
    # A line break moves from the end of one file to the start of the next: all files together are the same as before.
    (package / "a.py").write_text("x = 1")
    (package / "b.py").write_text("\ny = 2\n")
    hashes.append(found())
    for function in ("importlib.metadata.version", "platform.python_version"):
        monkeypatch.setattr(function, lambda *_: "0.0.1")
        hashes.append(found())
    assert len(set(hashes)) == 6


def test_missing_code_and_missing_libraries_are_errors(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(str(tmp_path))
    (tmp_path / "empty_package").mkdir()
    for package in ("no_such_package", "empty_package"):
        with pytest.raises(DiffbotError, match=f"the source code of {package} is not found"):
            hash_of_code([package])
    with pytest.raises(DiffbotError, match="the version of no-such-library is not found"):
        hash_of_code(["diffbot_core"], ["no-such-library"])
