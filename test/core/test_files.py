"""Output folders, files that are replaced as a whole, and JSON of numbers that JSON does not have."""

import json
import math

import numpy as np
import pytest

from diffbot_core.errors import DiffbotError
from diffbot_core.files import output_folder, replacing, write_json


def test_a_folder_is_created_with_its_parents(tmp_path):
    with output_folder(tmp_path / "new" / "folder") as folder:
        assert folder.is_dir()


def test_a_file_in_the_way_is_one_line(tmp_path):
    (tmp_path / "file").write_text("mine")
    with pytest.raises(DiffbotError, match=r"cannot write to .*file: "), output_folder(tmp_path / "file"):
        pytest.fail("entered")


def test_what_cannot_be_written_inside_is_an_error_of_the_folder(tmp_path):
    with pytest.raises(DiffbotError, match=rf"cannot write to {tmp_path}: Is a directory"), output_folder(tmp_path):
        tmp_path.write_text("")


def test_a_file_is_replaced_only_at_the_end(tmp_path):
    path = tmp_path / "file"
    path.write_text("old")
    with replacing(path) as part:
        part.write_text("new")
        assert path.read_text() == "old"
    assert path.read_text() == "new"
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("error", [OSError, KeyboardInterrupt])
def test_a_failure_leaves_the_old_file_alone(tmp_path, error):
    path = tmp_path / "file"
    path.write_text("old")

    def fail_half_way():
        with replacing(path) as part:
            part.write_text("half")
            raise error

    with pytest.raises(error):
        fail_half_way()
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_json_has_texts_for_numbers_that_it_lacks(tmp_path):
    content = {"a": [1.5, math.inf, (-math.inf, np.float64(2.0))], "b": {"c": math.nan, "d": None, "e": True}}
    write_json(tmp_path / "file.json", content)

    def refuse(text):
        raise AssertionError(text)

    found = json.loads((tmp_path / "file.json").read_text(), parse_constant=refuse)
    assert found == {"a": [1.5, "inf", ["-inf", 2.0]], "b": {"c": "nan", "d": None, "e": True}}
