"""Errors: one base, one line, and whole after a journey between processes."""

import pickle

import pytest

from diffbot_core.errors import BadMessageError, InvalidValueError, ReplacedNameError


@pytest.mark.parametrize(
    "error",
    [
        InvalidValueError("gamma", -1.0, "> 0"),
        ReplacedNameError("k2", 1.0, "k_2", "> 0"),
        BadMessageError("too old", "by 3 s"),
    ],
)
def test_errors_survive_the_way_from_a_worker_process(error):
    # An exception that cannot be unpickled takes the whole pool of workers down.
    twin = pickle.loads(pickle.dumps(error))
    assert type(twin) is type(error)
    assert str(twin) == str(error)
    assert vars(twin) == vars(error)
