"""A small certificate of the tuned law: it holds, is read back, and planted mistakes are found."""

import json
import math

import numpy as np
import pytest

from diffbot_control.law.configuration import ControllerConfig
from diffbot_core.errors import DiffbotError, InvalidValueError
from diffbot_core.geometry import Pose
from diffbot_lab.stability.adversary.drift import drift
from diffbot_lab.stability.rank.ranking import UNRANKED
from diffbot_lab.stability.result_file import pack
from diffbot_lab.stability.tuned.certify import Contract, Plan, certify, core_radius, steps_from
from diffbot_lab.stability.tuned.file import load_tuned, save_tuned
from diffbot_lab.stability.tuned.table import CORE, cell_of, kept_index
from diffbot_lab.stability.tuned.verify import sample, verify

CONFIG = ControllerConfig()
PLAN = Plan(finish=True, to=1.9, fineness=0.4)


@pytest.fixture(scope="module")
def certificate():
    return certify(CONFIG, PLAN)


def changed(certificate, at, rank):
    ranks = certificate.ranks.copy()
    ranks[at] = rank
    return certificate._replace(ranks=ranks)


def test_the_certificate_is_read_back_and_verified(certificate, tmp_path):
    save_tuned(tmp_path / "tuned.json", certificate)
    found = load_tuned(tmp_path / "tuned.json")
    assert (found.plan, found.config) == (PLAN, CONFIG)
    np.testing.assert_array_equal(found.ranks, certificate.ranks)
    claims = verify(found)
    assert (claims.radius, claims.start) == (core_radius(certificate), 1.9)
    assert 0 < claims.steps == steps_from(certificate, 1.9)
    assert certificate.near.finishing < claims.radius < 1.6


def test_random_steps_of_the_robots_own_law_keep_to_the_ranks(certificate):
    assert sample(certificate, 200_000, 17).broken == 0


def test_random_steps_find_ranks_of_another_law(certificate):
    weak = CONFIG._replace(profile_gains=CONFIG.profile_gains._replace(turn_react=5.0))
    assert sample(certificate._replace(config=weak), 200_000, 17).broken > 0


def test_a_law_with_another_gain_is_not_verified_with_these_ranks(certificate):
    weak = CONFIG._replace(profile_gains=CONFIG.profile_gains._replace(turn_react=5.0))
    with pytest.raises(DiffbotError, match="not verified"):
        verify(certificate._replace(config=weak))


def test_a_rank_that_is_one_too_small_is_found(certificate):
    at = int(np.argmax(certificate.ranks))
    with pytest.raises(DiffbotError, match="rank that is not smaller"):
        verify(changed(certificate, at, certificate.ranks[at] - 1))


def test_a_cell_that_is_left_out_is_found(certificate):
    row = int(np.searchsorted(certificate.table.rho, 1.5))
    with pytest.raises(DiffbotError, match="not verified"):
        verify(changed(certificate, int(certificate.table.start[row]) + 5, UNRANKED))


def test_a_core_without_the_reach_of_omega_l_is_found(certificate):
    assert certificate.ranks[0] == CORE
    with pytest.raises(DiffbotError, match="Omega_L may lead"):
        verify(changed(certificate, 0, 1))


@pytest.mark.parametrize(
    ("change", "part"),
    [
        ({"format": "other"}, "is no file of the format 'diffbot stability tuned 1'"),
        ({"plan": None}, "a value is missing or of the wrong kind"),
        ({"plan.to": 1e9}, "to = 1000000000.0: must be from 0.1 to 1000"),
        ({"plan.other": 1}, "a value is missing or of the wrong kind"),
        ({"plan.contract": {"eps_xy": True}}, "eps_xy = True: must be from 1e-6"),
        ({"plan.contract": {"sigma_max": float("nan")}}, "sigma_max = nan: must be from 1e-6"),
        ({"controller": [1]}, "a value is missing or of the wrong kind"),
        ({"controller.brake": "fast"}, "brake = 'fast'"),
        ({"ranks": "%%%"}, "ranks: "),
        ({"ranks": 3}, "ranks: must be a text"),
        ({"ranks": pack(bytes(10))}, "ranks: must hold"),
    ],
)
def test_hostile_files_are_refused_in_one_line(certificate, tmp_path, change, part):
    path = tmp_path / "tuned.json"
    save_tuned(path, certificate)
    content = json.loads(path.read_text())
    for name, value in change.items():
        *outer, last = name.split(".")
        (content[outer[0]] if outer else content)[last] = value
    path.write_text(json.dumps(content))
    with pytest.raises(DiffbotError) as caught:
        load_tuned(path)
    assert str(caught.value).startswith(f"{path}: ")
    assert part in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("field", "value"), [("to", math.nan), ("fineness", 1e9), ("margin", -1.0), ("finish", 1), ("to", "12")]
)
def test_a_plan_of_bad_values_is_refused_by_name(field, value):
    with pytest.raises(InvalidValueError, match=field):
        certify(CONFIG, PLAN._replace(**{field: value}))


def test_a_cell_and_its_mirror_image_are_kept_in_one_place(certificate):
    table = certificate.table
    alphas, betas = int(table.alphas[0]), int(table.betas[0])
    for i, j in ((0, 0), (alphas // 2, 3), (alphas - 1, betas - 1), (alphas // 2 + 7, 0)):
        assert kept_index(table, 0, i, j) == kept_index(table, 0, alphas - 1 - i, betas - 1 - j)
    cell = cell_of(table, 0, kept_index(table, 0, alphas // 2 + 7, 2))
    assert cell.alpha_low == pytest.approx(7 * 2.0 * math.pi / alphas)
    assert cell.beta_low == pytest.approx(-math.pi + 2 * 2.0 * math.pi / betas)


def test_an_adversary_comes_near_the_bounds_of_omega_l_but_not_beyond(certificate):
    near, start = certificate.near, Pose(0.0, 0.33, 0.0)
    idle = CONFIG._replace(finish=CONFIG.finish._replace(finish_tries=0))
    aside = drift(idle, Contract(), start, 6000)
    assert 0.34 < aside.farthest < near.holding
    away = drift(CONFIG, Contract(), start, 6000)
    assert 0.8 < away.farthest < near.finishing
