"""The figure of the picture shows each map the right way round, and the tails of the observed errors."""

import math

import figures
import numpy as np
import pytest
from figures import drawn  # noqa: F401 - a fixture

from diffbot_lab.stability.picture import figure

RHO = np.array([0.5, 1.5, 2.5, 3.5])
ANGLE = np.array([-2.5, -1.5, -0.5, 0.5, 1.5, 2.5])


def pattern(positive):
    """Return rates (n_rho, n_angle), all -1 but where they are to be +1."""
    rates = np.full((len(RHO), len(ANGLE)), -1.0)
    for at in positive:
        rates[at] = 1.0
    return rates


# Neither is its own mirror image in any direction, nor the other one.
OVER_ALPHA = pattern([(0, 0), (1, 0), (2, 0), (0, 1)])
OVER_BETA = pattern([(3, 5), (3, 4), (3, 3), (2, 5)])
GRID = {"distance_of_level": 3.2, "heading_bound_local": 0.25}


@pytest.fixture
def axes(drawn):  # noqa: F811
    saved = drawn(figure)
    maps = {"rho": RHO, "angle": ANGLE, "over_alpha": OVER_ALPHA, "over_beta": OVER_BETA}
    observed = {"position": np.array([0.4, 0.1, 0.2, 0.3]), "abs_theta": np.array([0.01, 1e-9])}
    figure.draw_picture(GRID, maps, observed, None)
    (picture,) = saved
    return picture.axes[:3]


@pytest.mark.parametrize(("panel", "rates"), [(0, OVER_ALPHA), (1, OVER_BETA)], ids=["alpha", "beta"])
def test_each_point_of_a_map_has_the_colour_of_its_own_rate(axes, panel, rates):
    axes[panel].get_legend().remove()  # it covers a corner
    points = [(rho + 0.2, angle + 0.2) for rho in RHO for angle in ANGLE]  # beside the grid lines
    colours = figures.colours_at(axes[panel], points).reshape(*rates.shape, 3)
    red, _, blue = np.moveaxis(colours, -1, 0)
    np.testing.assert_array_equal(red - blue > 0.2, rates > 0.0)
    np.testing.assert_array_equal(blue - red > 0.2, rates < 0.0)


def test_axes_are_labelled_with_what_they_show(axes):
    assert [one.get_xlabel() for one in axes[:2]] == ["rho [m]"] * 2
    assert [one.get_ylabel() for one in axes[:2]] == ["alpha [rad]", "beta [rad]"]
    for one, other in zip(axes[:2], ("beta", "alpha"), strict=True):
        assert one.get_title() == f"worst dV/dt over the noise and {other}; blue: V decreases at this point"
        np.testing.assert_allclose(one.get_xlim(), (0.0, 4.0))
        np.testing.assert_allclose(one.get_ylim(), (-3.0, 3.0))
        assert set(figures.lines(one)["highest increase"].get_xdata()) == {3.2}


def test_the_tails_are_the_shares_of_runs_above_each_error(axes):
    found = figures.lines(axes[2])
    position, theta = found["observed |position| [m]"], found["observed |theta| [rad]"]
    shares = dict(zip(position.get_xdata(), position.get_ydata(), strict=True))
    assert shares == {0.4: 0.25, 0.3: 0.5, 0.2: 0.75, 0.1: 1.0}
    assert dict(zip(theta.get_xdata(), theta.get_ydata(), strict=True)) == {0.01: 0.5, 1e-5: 1.0}
    heading, distance = found["bound of |theta| in Omega_L"], found["highest increase on the grid, law (13)"]
    assert set(heading.get_xdata()) == {0.25}
    assert set(distance.get_xdata()) == {3.2}
    assert heading.get_color() == theta.get_color() != position.get_color() == distance.get_color()
    assert axes[2].get_xscale() == axes[2].get_yscale() == "log"
    assert axes[2].get_xlim()[0] == pytest.approx(1e-3)


def test_a_map_of_one_sign_and_an_infinite_bound_are_drawn(drawn):  # noqa: F811
    saved = drawn(figure)
    maps = {"rho": RHO, "angle": ANGLE, "over_alpha": -np.abs(OVER_ALPHA), "over_beta": OVER_BETA}
    observed = {"position": np.array([0.4]), "abs_theta": np.array([0.0])}
    grid = {"distance_of_level": 0.0, "heading_bound_local": math.inf}
    figure.draw_picture(grid, maps, observed, None)
    red, _, blue = figures.colours_at(saved[0].axes[0], [(0.7, 0.7)])[0]
    assert blue - red > 0.2
