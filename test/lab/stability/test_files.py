"""Files of certificates of both laws: what is written is read, and no hostile file gets through."""

import base64
import json
import math
import tracemalloc

import numpy as np
import pytest
from certificates import LAW_17, coarse_certificate

from diffbot_core.errors import DiffbotError
from diffbot_lab.stability.paper.file import load_certificate, save_certificate
from diffbot_lab.stability.result_file import pack, unpack
from diffbot_lab.stability.tuned.file import load_tuned, save_tuned


@pytest.fixture
def path(law, request, tmp_path):
    """The file of a certificate of the law, ``paper`` or ``tuned``."""
    path = tmp_path / "one.json"
    if law == "paper":
        save_certificate(path, coarse_certificate(LAW_17), {"seconds": 1.0})
    else:
        save_tuned(path, request.getfixturevalue("certificate"))
    return path


def assert_same_arrays(found, written, names):
    for name in names:
        np.testing.assert_array_equal(getattr(found, name), getattr(written, name))
        assert getattr(found, name).dtype == getattr(written, name).dtype


@pytest.mark.parametrize("law", ["paper"])
def test_what_is_written_of_the_papers_law_is_read_to_the_bit(path):
    written, found = coarse_certificate(LAW_17), load_certificate(path)
    assert (found.loop, found.claims) == (written.loop, written.claims)
    assert_same_arrays(found, written, ("rho", "alpha", "ranks"))


@pytest.mark.parametrize("law", ["tuned"])
def test_what_is_written_of_the_tuned_law_is_read_to_the_bit(certificate, path):
    found = load_tuned(path)
    assert (found.plan, found.config, found.claims) == (certificate.plan, certificate.config, certificate.claims)
    assert_same_arrays(found, certificate, ("rho", "alphas", "betas", "ranks"))


def with_first(values, value):
    return [value, *values[1:]]


PAPER = [
    ({"format": "diffbot stability certificate 2"}, "is no diffbot stability certificate 1"),
    ({"loop.gamma": -1.0}, "gamma = -1.0: must be from 1e-09 to 1000"),
    ({"loop.eps_theta": 3.2}, "eps_theta = 3.2: must be <= pi"),
    ({"loop.eps_P_leave": 0.1}, "eps_P_leave = 0.1: must be >= eps_P"),
    ({"loop.plant": "moon"}, "plant = 'moon'"),
    ({"rho": [1.0, 1.0]}, "rho: must be increasing edges"),
    ({"alpha": [0.0, math.inf]}, "alpha: must be increasing edges"),
    ({"rho": list(range(20_000)), "alpha": list(range(20_000))}, "cells = 399960001: must be <= 100000000"),
    ({"ranks": pack(bytes(2 * 10**6))}, "ranks: must hold"),
    ({"ranks": base64.b64encode(b"not packed").decode()}, "ranks: "),
    ({"claims": {}}, "a value is missing or of the wrong kind: 'steps'"),
    ({"claims.radius": math.inf}, "claims: must be finite"),
]
TUNED = [
    ({"format": "diffbot stability tuned 1"}, "is no file of the format 'diffbot stability tuned 3'"),
    ({"plan.to": 1e9}, "to = 1000000000.0: must be from 0.1 to 1000"),
    ({"plan.contract.sigma_max": math.nan}, "sigma_max = nan: must be from 1e-06 to 0.999"),
    ({"controller.command_latency": 0.1}, "eps_v = 0.0: must be above 0 with"),
    ({"controller": {"speed_profile": "braking"}}, "controller: without allow_backward, "),
    ({"plan.contract": {"sigma_max": 0.02}}, "plan.contract: must have eps_position, eps_theta, "),
    ({"plan.period": 0.0}, "period = 0.0: must be from 0.001 to 10"),
    ({"rho": 3}, "rho: must be a list of 2 to 20001 edges"),
    ({"rho": lambda values: with_first(values, math.nan)}, "rho = nan: must be from 1e-06 to 10000"),
    ({"rho": lambda values: with_first(values, values[1])}, "the edge before it"),
    ({"rho": lambda values: values[:-1]}, "alphas: must be a list of"),
    ({"alphas": lambda values: with_first(values, 7)}, "alphas = 7: must be even"),
    ({"betas": lambda values: with_first(values, True)}, "betas = True: must be a whole number from 4"),
    ({"betas": lambda values: with_first(values, 10**30)}, "must be a whole number from 4 to 16000"),
    ({"betas": lambda values: [16_000] * len(values), "alphas": lambda values: [16_000] * len(values)}, "cells = "),
    ({"ranks": pack(bytes(10))}, "ranks: must hold"),
    ({"claims.other": 3}, "a value is missing or of the wrong kind"),
    ({"claims.radius": "1"}, "claims.radius = '1': must be from 0"),
    ({"claims.steps": True}, "claims.steps = True: must be a whole number"),
]


@pytest.mark.parametrize(
    ("law", "change", "part"), [*(("paper", *one) for one in PAPER), *(("tuned", *one) for one in TUNED)]
)
def test_hostile_files_are_refused_in_one_line(path, law, change, part):
    content = json.loads(path.read_text())
    for name, value in change.items():
        *outer, last = name.split(".")
        fields = content
        for one in outer:
            fields = fields[one]
        fields[last] = value(fields[last]) if callable(value) else value
    path.write_text(json.dumps(content))
    with pytest.raises(DiffbotError) as caught:
        (load_certificate if law == "paper" else load_tuned)(path)
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
