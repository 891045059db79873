"""Errors: one base, one line of bounded length, and whole after a journey between processes."""

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
)  # fmt: skip
def test_errors_survive_the_way_from_a_worker_process(error, text):
    # An exception that cannot be unpickled takes the whole pool of workers down.
    twin = pickle.loads(pickle.dumps(error))
    assert isinstance(twin, DiffbotError)
    assert (type(twin), str(twin), vars(twin)) == (type(error), text, vars(error))


VALUES = {"text": "x" * 10**6, "list": list(range(10**5)), "number": 10**10_000, "map": {n: "\n" for n in range(999)}}


@pytest.mark.parametrize("value", VALUES.values(), ids=VALUES)
def test_a_value_from_outside_is_shown_in_one_short_line(value):
    for text in (str(InvalidValueError("a\nname", value, "> 0")), shown(value) if isinstance(value, str) else ""):
        assert len(text) < 400
        assert "\n" not in text
    assert shown("\x1b[31m") == r"'\x1b[31m'"


def test_an_unknown_name_is_answered_with_similar_ones_and_a_short_list():
    assert known_name("gama", ["gamma", "h"]) == "a known name (gamma, h): did you mean gamma?"
    many = [f"parameter_{number}" for number in range(50)]
    assert known_name("x", many).endswith(" ... 50 in all)")
    assert known_name("parameter_7x", many).startswith("a known name: did you mean parameter_7")
