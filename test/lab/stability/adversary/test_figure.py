"""The figure of a certificate shows its core, its times, and the trajectories at the right places."""

import math

import figures
import numpy as np
import pytest
from certificates import LAW_17, coarse_certificate
from figures import drawn  # noqa: F401 - a fixture

from diffbot_lab.stability.adversary import figure


@pytest.fixture
def axes(drawn):  # noqa: F811
    saved = drawn(figure)
    # The goal is 0.5 m away on the left of the robot, and 0.3 m behind it.
    attack, cloud = np.array([[-0.5, 0.0, -math.pi / 2]]), np.array([[0.3, 0.0, 0.1]])
    figure.draw_near_field(figure.field_of_paper(coarse_certificate(LAW_17)), attack, cloud, None)
    (picture,) = saved
    return picture.axes


def test_trajectories_are_at_their_alpha_and_rho(axes):
    found = figures.lines(axes[0])["adversary"]
    np.testing.assert_allclose(found.get_xydata(), [[math.pi / 2, 0.5]])
    cloud = axes[0].get_lines()[0]
    np.testing.assert_allclose(cloud.get_xydata(), [[math.pi - 0.1, 0.3]])
    assert (axes[0].get_xlabel(), axes[0].get_ylabel()) == ("alpha [rad]", "rho [m]")
