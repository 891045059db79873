"""Files of certificates: what is written is read, and no hostile file gets through."""

import base64
import json
import zlib

import numpy as np
import pytest
from certificates import LAW_17, coarse_certificate

from diffbot_core.errors import DiffbotError
from diffbot_lab.stability.paper.file import load_certificate, save_certificate


@pytest.fixture
def path(tmp_path):
    save_certificate(tmp_path / "one.json", coarse_certificate(LAW_17), {"seconds": 1.0})
    return tmp_path / "one.json"


def test_what_is_written_is_read_to_the_bit(path):
    written, found = coarse_certificate(LAW_17), load_certificate(path)
    assert found.loop == written.loop
    assert found.claims == written.claims
    for name in ("rho", "alpha", "ranks"):
        np.testing.assert_array_equal(getattr(found, name), getattr(written, name))
    assert found.ranks.dtype == np.int16


def packed(values):
    return base64.b64encode(zlib.compress(np.asarray(values, "<i2").tobytes())).decode()


@pytest.mark.parametrize(
    ("change", "part"),
    [
        ({"format": "diffbot stability certificate 2"}, "is no diffbot stability certificate 1"),
        ({"loop.gamma": -1.0}, r"gamma = -1.0: must be from 1e-09 to 1000"),
        ({"loop.eps_theta": 3.2}, "eps_theta = 3.2: must be <= pi"),
        ({"loop.eps_P_leave": 0.1}, "eps_P_leave = 0.1: must be >= eps_P"),
        ({"loop.plant": "moon"}, "plant = 'moon'"),
        ({"rho": [1.0, 1.0]}, "rho: must be increasing edges"),
        ({"alpha": [0.0, float("inf")]}, "alpha: must be increasing edges"),
        ({"rho": list(range(20_000)), "alpha": list(range(20_000))}, "cells = 399960001: must be <= 100000000"),
        ({"ranks": packed(np.zeros(10**6))}, "ranks: must hold"),
        ({"ranks": base64.b64encode(b"not packed").decode()}, "ranks: "),
        ({"claims": {}}, "a value is missing or of the wrong kind: 'steps'"),
        ({"claims.radius": float("inf")}, "claims: must be finite"),
    ],
)
def test_hostile_values_are_refused_in_one_line(path, change, part):
    content = json.loads(path.read_text())
    for name, value in change.items():
        *outer, last = name.split(".")
        (content[outer[0]] if outer else content)[last] = value
    path.write_text(json.dumps(content))
    with pytest.raises(DiffbotError, match=part) as caught:
        load_certificate(path)
    assert "\n" not in str(caught.value)
    assert str(caught.value).startswith(str(path))
