"""Errors are one short line, and survive pickling."""

import pickle

import pytest

from diffbot_core.errors import BadMessageError, DiffbotError, InvalidValueError, known_name, shown


@pytest.mark.parametrize(
    ("error", "text"),
    [
        (InvalidValueError("gamma", -1.0, "> 0"), "gamma = -1.0: must be > 0"),
        (InvalidValueError("wall_x1", [1.0], sentence="wall 0 is a point"), "wall_x1 = [1.0]: wall 0 is a point"),
        (BadMessageError("too old", "by 3 s"), "too old: by 3 s"),
    ],
)
def test_errors_keep_text_and_fields_when_they_are_pickled(error, text):
    # An exception that cannot be unpickled breaks a pool of worker processes.
    copy = pickle.loads(pickle.dumps(error))
    assert isinstance(copy, DiffbotError)
    assert (type(copy), str(copy), vars(copy)) == (type(error), text, vars(error))


VALUES = {"text": "x" * 10**6, "list": list(range(10**5)), "number": 10**10_000, "map": {n: "\n" for n in range(999)}}


@pytest.mark.parametrize("value", VALUES.values(), ids=VALUES)
def test_an_error_about_a_huge_value_is_one_short_line(value):
    text = str(InvalidValueError("a\nname", value, "> 0"))
    assert len(text) < 400
    assert "\n" not in text


def test_a_text_from_outside_is_shown_in_bounded_length_without_control_characters():
    assert len(shown("x" * 10**6)) < 300
    assert shown("\x1b[31m") == r"'\x1b[31m'"


def test_an_unknown_name_is_reported_with_similar_names_and_a_bounded_list():
    assert known_name("gama", ["gamma", "h"]) == "a known name (gamma, h): did you mean gamma?"
    many = [f"parameter_{number}" for number in range(50)]
    assert known_name("x", many).endswith(" ... 50 in all)")
    assert known_name("parameter_7x", many).startswith("a known name: did you mean parameter_7")
