"""Files of certificates: what is written is read, and no hostile file gets through."""

import base64
import json
import math
import tracemalloc

import numpy as np
import pytest

from diffbot_core.errors import DiffbotError
from diffbot_lab.stability.file import load_certificate, pack, save_certificate, unpack


@pytest.fixture
def path(certificate, tmp_path):
    path = tmp_path / "one.json"
    save_certificate(path, certificate)
    return path


def test_what_is_written_is_read_to_the_bit(certificate, path):
    found = load_certificate(path)
    assert (found.plan, found.config, found.claims) == (certificate.plan, certificate.config, certificate.claims)
    for name in ("rho", "alphas", "betas", "ranks"):
        np.testing.assert_array_equal(getattr(found, name), getattr(certificate, name))
        assert getattr(found, name).dtype == getattr(certificate, name).dtype


def with_first(values, value):
    return [value, *values[1:]]


HOSTILE = [
    ({"format": "diffbot stability tuned 3"}, "is no file of the format 'diffbot stability 5'"),
    ({"plan.to": 1e9}, "to = 1000000000.0: must be from 0.1 to 1000"),
    ({"controller.command_latency": 0.1}, "eps_v = 0.0: must be above 0 with"),
    ({"controller": {"allow_backward": True}}, "controller: without "),
    ({"plan.contract": {"sigma_max": 0.02}}, "plan.contract: must have eps_position, eps_theta, "),
    ({"rho": 3}, "rho: must be a list of 2 to 20001 edges"),
    ({"rho": lambda values: with_first(values, math.nan)}, "rho = nan: must be from 1e-06 to 10000"),
    ({"rho": lambda values: values[:-1]}, "alphas: must be a list of"),
    ({"alphas": lambda values: with_first(values, 7)}, "alphas = 7: must be even"),
    ({"betas": lambda values: with_first(values, 10**30)}, "must be a whole number from 4 to 16000"),
    ({"betas": lambda values: [16_000] * len(values), "alphas": lambda values: [16_000] * len(values)}, "cells = "),
    ({"ranks": pack(bytes(10))}, "ranks: must hold"),
    ({"ranks": base64.b64encode(b"not packed").decode()}, "ranks: "),
    ({"claims.other": 3}, "a value is missing or of the wrong kind"),
    ({"claims.steps": True}, "claims.steps = True: must be a whole number"),
]


@pytest.mark.parametrize(("change", "part"), HOSTILE)
def test_hostile_files_are_refused_in_one_line(path, change, part):
    content = json.loads(path.read_text())
    for name, value in change.items():
        *outer, last = name.split(".")
        fields = content
        for one in outer:
            fields = fields[one]
        fields[last] = value(fields[last]) if callable(value) else value
    path.write_text(json.dumps(content))
    with pytest.raises(DiffbotError) as caught:
        load_certificate(path)
    assert str(caught.value).startswith(str(path))
    assert part in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_bomb_is_not_unpacked():
    bomb = pack(bytes(10**8))
    tracemalloc.start()
    try:
        with pytest.raises(DiffbotError, match="must hold 10 bytes"):
            unpack("ranks", bomb, 10)
        assert tracemalloc.get_traced_memory()[1] < 10**6
    finally:
        tracemalloc.stop()
