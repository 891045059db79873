"""What is installed: names and plug-ins, and hashes that change with all code and all values that made a result."""

import math
import subprocess
import sys
from importlib.metadata import version
from typing import NamedTuple

import numpy as np
import pytest

from diffbot_core.errors import DiffbotError
from diffbot_core.installed import DISTRIBUTION, entry_points_by_name, hash_of_code, hash_of_values, install_hint


def test_the_hint_installs_the_project_itself():
    assert version(DISTRIBUTION)
    assert install_hint("pandas") == "pip install 'diffbot-ros[pandas]'"


@pytest.fixture
def earlier(tmp_path):
    """What an installation under the earlier name leaves behind."""
    folder = tmp_path / "diffbot-0.0.9.dist-info"
    folder.mkdir()
    (folder / "METADATA").write_text("Metadata-Version: 2.1\nName: diffbot\nVersion: 0.0.9\n")
    (folder / "entry_points.txt").write_text("[diffbot.commands]\ncampaign = earlier:add\nearlier = earlier:add\n")
    return tmp_path


def test_of_two_entry_points_with_one_name_the_first_on_the_path_counts(earlier, monkeypatch):
    own = entry_points_by_name("diffbot.commands")
    assert list(own) == sorted(own)
    assert own["campaign"].value.startswith("diffbot_lab.")
    monkeypatch.syspath_prepend(str(earlier))
    found = entry_points_by_name("diffbot.commands")
    assert set(found) == {*own, "earlier"}
    assert found["campaign"].value == "earlier:add"
    monkeypatch.undo()
    monkeypatch.setattr(sys, "path", [*sys.path, str(earlier)])
    assert entry_points_by_name("diffbot.commands")["campaign"] == own["campaign"]


def test_the_command_works_beside_an_earlier_installation(earlier):
    program = f"import sys; sys.path.append({str(earlier)!r}); from diffbot_tools.cli import main; main(['--version'])"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout == f"diffbot {version(DISTRIBUTION)}\n"


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
    # From the end of one file to the beginning of the next: all files together read the same as before.
    (package / "a.py").write_text("x = 1")
    (package / "b.py").write_text("\ny = 2\n")
    hashes.append(found())
    for function in ("importlib.metadata.version", "platform.python_version"):
        monkeypatch.setattr(function, lambda *_: "0.0.1")
        hashes.append(found())
    assert len(set(hashes)) == 6


def test_code_without_source_has_no_hash(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(str(tmp_path))
    (tmp_path / "empty_package").mkdir()
    for package in ("no_such_package", "empty_package"):
        with pytest.raises(DiffbotError, match=f"the source code of {package} is not found"):
            hash_of_code([package])
    with pytest.raises(DiffbotError, match="the version of no-such-library is not found"):
        hash_of_code(["diffbot_core"], ["no-such-library"])


class Gains(NamedTuple):
    k: float
    h: float


class Weights(NamedTuple):
    k: float
    h: float


def test_each_value_its_field_and_its_last_bit_count():
    values = [
        Gains(1.0, 2.0),
        Gains(2.0, 1.0),
        Gains(1.0, math.nextafter(2.0, 3.0)),
        Weights(1.0, 2.0),
        [1.0, 2.0],
        {"k": 1.0, "h": 2.0},
        np.array([[1.0, 2.0]]),
        np.array([1.0, math.inf]),
        [1.0, None],
        [1.0, True],
        [1.0, 1],
        [1.0, "1"],
        (Gains(1.0, 2.0), Gains(1.0, 2.0)),
    ]
    assert len({hash_of_values([value]) for value in values}) == len(values)
    assert hash_of_values(values) != hash_of_values(values[::-1])
    assert hash_of_values([np.array([1.0, 2.0])]) == hash_of_values([(1.0, 2.0)])
    assert hash_of_values([{"h": 2.0, "k": 1.0}]) == hash_of_values([{"k": 1.0, "h": 2.0}])
