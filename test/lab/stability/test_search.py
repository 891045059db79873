"""The search finds the better adversary, and what it reaches is within what is certified."""

import numpy as np

from diffbot_lab.stability.adversary.play import play
from diffbot_lab.stability.adversary.search import FEATURES, STEPS, WARM_UP, WINDOW, recurrent_distance, search
from diffbot_lab.stability.runs import loop_of


def test_the_recurrent_distance_is_reached_in_every_window():
    path = np.zeros((STEPS, 3))
    path[: WARM_UP - 1, 0] = 9.0
    path[WARM_UP::WINDOW, 1] = 0.5
    path[WARM_UP + WINDOW, 1] = -3.0
    assert recurrent_distance(path) == 0.5
    path[-1, 0] = 7.0
    path[WARM_UP + 2 * WINDOW] = 0.0
    assert recurrent_distance(path) == 0.0


def test_what_is_certified_withstands_the_search(certificate):
    loop, shown = loop_of(certificate), []
    attack = search(
        lambda *where: play(loop, *where), 0.3, 1, generations=3, population=8, threads=1, each=shown.append
    )
    assert shown == sorted(shown)
    assert shown[-1] == attack.distance == recurrent_distance(attack.path)
    assert 0.03 < attack.distance < certificate.claims.radius
    assert attack.weights.shape == (FEATURES,)
