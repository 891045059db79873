"""Errors: one base, one line, and whole after a journey between processes."""

import copy
import pickle

import pytest

from diffbot_core.errors import BadMessageError, DiffbotError, InvalidValueError


def test_an_invalid_value_names_field_value_and_bound():
    error = InvalidValueError("gamma", -1.0, "> 0")
    assert str(error) == "gamma = -1.0: must be > 0"
    assert (error.name, error.value, error.bound) == ("gamma", -1.0, "> 0")
    assert str(InvalidValueError("clock", "sun", "one of wall")) == "clock = 'sun': must be one of wall"


def test_a_bad_message_has_a_stable_kind():
    assert str(BadMessageError("too old")) == "too old"
    error = BadMessageError("too old", "by 3 s")
    assert (str(error), error.kind) == ("too old: by 3 s", "too old")


@pytest.mark.parametrize(
    "error",
    [
        DiffbotError("plain"),
        InvalidValueError("gamma", -1.0, "> 0"),
        BadMessageError("too old", "by 3 s"),
        BadMessageError("too old"),
    ],
)
@pytest.mark.parametrize("copied", [lambda one: pickle.loads(pickle.dumps(one)), copy.copy])
def test_errors_survive_the_way_from_a_worker_process(error, copied):
    # An exception that cannot be unpickled takes the whole pool of workers down.
    twin = copied(error)
    assert isinstance(twin, DiffbotError)
    assert type(twin) is type(error)
    assert str(twin) == str(error)
    assert vars(twin) == vars(error)
