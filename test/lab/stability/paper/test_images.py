"""Images hold every step of the project's own law and plant, and are not much larger than what can be reached."""

import math

import numpy as np
import pytest
from certificates import CELLS, PAPER_13, PAPER_17, assert_held, steps_from

from diffbot_lab.stability.paper.certify import images_loop
from diffbot_lab.stability.paper.file import EXACT_ARC
from diffbot_lab.stability.paper.images import images, most_images
from diffbot_lab.stability.rank.cells import Cell

LOOPS = {"13": PAPER_13, "17": PAPER_17, "17 arc": PAPER_17._replace(plant=EXACT_ARC, eps_P_leave=0.6)}


def boxes_of(loop, cell):
    inner = images_loop(loop, 0.05)
    out = np.empty((most_images(inner, cell.rho_low), 4))
    return out[: images(inner, cell, out)]


@pytest.mark.parametrize(("name", "cell"), [("13", CELLS[0]), ("17", CELLS[1]), *(("17 arc", one) for one in CELLS)])
def test_every_step_from_a_cell_ends_in_its_images(name, cell):
    loop = LOOPS[name]
    assert_held(steps_from(loop, cell, 200, np.random.default_rng(1)), *boxes_of(loop, cell).T)


@pytest.mark.parametrize("name", LOOPS)
def test_images_are_not_much_wider_than_what_is_reached(name):
    loop, cell = LOOPS[name], CELLS[2]
    boxes = boxes_of(loop, cell)
    rho = steps_from(loop, cell, 2000, np.random.default_rng(2))[:, 0]
    assert boxes[:, 1].max() - rho.max() < 0.02
    assert rho.min() - boxes[:, 0].min() < 0.02


def test_without_noise_and_for_a_point_the_image_is_the_step_for_all_beta():
    loop = PAPER_13._replace(eps_x=0.0, eps_y=0.0, eps_theta=0.0, eps_v=0.0, eps_omega=0.0)
    boxes = boxes_of(loop, Cell(1.0, 1.0, 0.7, 0.7))
    u = 0.1 * 1.3 * math.tanh(1.0) * math.cos(0.7)
    rho = math.hypot(1.0 - u * math.cos(0.7), u * math.sin(0.7))
    np.testing.assert_allclose(boxes[:, :2], rho, atol=1e-12)
    turn = math.atan2(u * math.sin(0.7), 1.0 - u * math.cos(0.7))
    slope = 1.3 * math.tanh(1.0) * math.cos(0.7) * math.sin(0.7) / 0.7
    omegas = [0.7 + slope * (0.7 + 0.17 * beta) for beta in (-math.pi, math.pi)]
    assert boxes[:, 2].min() == pytest.approx(0.7 + turn - 0.1 * max(omegas), abs=1e-12)
    assert boxes[:, 3].max() == pytest.approx(0.7 + turn - 0.1 * min(omegas), abs=1e-12)
