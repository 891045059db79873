"""Results are named by all code and all values that made them: whatever changes, the name changes."""

import math
import shutil
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

import diffbot_core
from diffbot_core.code_hash import hash_of_code, hash_of_folders, hash_of_values
from diffbot_core.errors import DiffbotError

SITE = Path(diffbot_core.__file__).parents[1]


@pytest.fixture
def package(tmp_path):
    shutil.copytree(SITE / "diffbot_core", tmp_path / "diffbot_core", ignore=shutil.ignore_patterns("__pycache__"))
    return tmp_path / "diffbot_core"


def test_new_removed_and_renamed_modules_and_moved_text_change_the_hash(package):
    found = {hash_of_folders([package])}
    (package / "ros" / "new.py").write_text("")
    found.add(hash_of_folders([package]))
    (package / "ros" / "new.py").rename(package / "new.py")
    found.add(hash_of_folders([package]))
    (package / "units.py").unlink()
    found.add(hash_of_folders([package]))
    # From the end of one file to the beginning of the next: all files together read the same as before.
    schema, uncertainty = package / "schema.py", package / "uncertainty.py"
    uncertainty.write_text(schema.read_text()[-1:] + uncertainty.read_text())
    schema.write_text(schema.read_text()[:-1])
    found.add(hash_of_folders([package]))
    assert len(found) == 5


@pytest.mark.parametrize("function", ["importlib.metadata.version", "platform.python_version"])
def test_another_version_of_python_or_of_a_library_changes_the_hash(package, function, monkeypatch):
    before = hash_of_folders([package], ["numpy"])
    monkeypatch.setattr(function, lambda *_: "0.0.1")
    assert hash_of_folders([package], ["numpy"]) != before


def test_code_without_source_has_no_name(tmp_path):
    with pytest.raises(DiffbotError, match="the source code of no_such_package is not found"):
        hash_of_code(["no_such_package"])
    with pytest.raises(DiffbotError, match="no version of no-such-library is found"):
        hash_of_code(["diffbot_core"], ["no-such-library"])
    with pytest.raises(DiffbotError, match="has no source code"):
        hash_of_folders([tmp_path])


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
