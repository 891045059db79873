"""Files of certificates: a written certificate is read unchanged, and invalid files are refused."""

import base64
import json
import math
import tracemalloc

import numpy as np
import pytest

from diffbot_core.errors import DiffbotError
from diffbot_lab.stability.file import load_certificate, pack, save_certificate, unpack


@pytest.fixture(scope="module")
def saved(certificate, tmp_path_factory):
    path = tmp_path_factory.mktemp("saved") / "one.json"
    save_certificate(path, certificate)
    return path


def test_a_written_certificate_is_read_unchanged(certificate, saved):
    found = load_certificate(saved)
    assert (found.plan, found.config, found.claims) == (certificate.plan, certificate.config, certificate.claims)
    for name in ("rho", "alphas", "betas", "ranks"):
        np.testing.assert_array_equal(getattr(found, name), getattr(certificate, name))
        assert getattr(found, name).dtype == getattr(certificate, name).dtype


def with_first(values, value):
    return [value, *values[1:]]


INVALID = [
    ({"format": "diffbot stability tuned 3"}, "is not a certificate with the format 'diffbot stability 5'"),
    ({"plan.to": 1e9}, "to = 1000000000.0: must be from 0.1 to 1000"),
    ({"controller.command_latency": 0.1}, "eps_v = 0.0: must be above 0 with"),
    ({"controller": {"allow_backward": True}}, "controller has no "),
    ({"plan.contract": {"sigma_max": 0.02}}, "plan.contract must have exactly the fields eps_position, eps_theta, "),
    ({"rho": lambda values: with_first(values, math.nan)}, "rho = nan: must be from 1e-06 to 10000"),
    ({"rho": lambda values: values[:-1]}, "alphas must be a list of"),
    ({"alphas": lambda values: with_first(values, 7)}, "alphas = 7: must be even"),
    ({"betas": lambda values: [16_000] * len(values), "alphas": lambda values: [16_000] * len(values)}, "cells = "),
    ({"ranks": base64.b64encode(b"not packed").decode()}, "ranks cannot be decoded: "),
    ({"claims.other": 3}, "a value is missing or has the wrong type"),
    ({"claims.steps": True}, "claims.steps = True: must be a whole number"),
]


@pytest.mark.parametrize(("change", "part"), INVALID)
def test_invalid_files_are_refused_in_one_line(saved, tmp_path, change, part):
    path, content = tmp_path / "changed.json", json.loads(saved.read_text())
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


def test_ranks_are_not_decompressed_beyond_their_size():
    bomb = pack(bytes(10**8))
    tracemalloc.start()
    try:
        with pytest.raises(DiffbotError, match="must contain 10 bytes"):
            unpack("ranks", bomb, 10)
        assert tracemalloc.get_traced_memory()[1] < 10**6
    finally:
        tracemalloc.stop()
