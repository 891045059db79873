"""Options of the filter: which variant, its gate, its way back, its noise."""

from __future__ import annotations

import math
from typing import Annotated, NamedTuple

from scipy.special import chdtri

from diffbot_core.schema import Spec

EKF, CALIBRATING, FNN, FNN_CALIBRATING = "ekf", "ekf_calibrating", "ekf_fnn", "ekf_fnn_calibrating"
FILTERS = (EKF, CALIBRATING, FNN, FNN_CALIBRATING)
"""Three states; with the radius errors of both wheels as two more; with a fuzzy-neural adaptation of R and Q."""


LOST_XY, LOST_THETA = 25.0, 1.0
"""[m^2], [rad^2] variances of a pose that headings and landmarks have contradicted for long"""
MIN_LANDMARK_DISTANCE = 1e-3
"""[m] nearer to a landmark its bearing means nothing"""
_MOST_SIGMAS, _MOST = 5.0, 0.1
"""An estimated radius error beyond so many deviations, and beyond a tenth, is a slip that was taken for one."""


class FilterConfig(NamedTuple):
    """Parameters of the filter."""

    filter: Annotated[str, Spec("variant of the filter", choices=FILTERS, read_only=True)] = CALIBRATING
    gate_probability: Annotated[
        float,
        Spec("share of good measurements that pass the chi-square gate; 1: no gate", minimum=0.5, maximum=1.0),
    ] = 0.999
    relocation_fixes: Annotated[
        int, Spec("rejections in a row after which fixes that agree are believed", minimum=2, maximum=100)
    ] = 3
    relocation_timeout: Annotated[
        float,
        Spec(
            "time of so many rejections and nothing else after which the newest is believed",
            "s",
            minimum=0.0,
            exclusive_minimum=True,
        ),
    ] = 1.5
    wheel_radius_sigma: Annotated[
        float, Spec("standard deviation of each wheel's relative radius error at the start", minimum=1e-6, maximum=0.2)
    ] = 0.01
    wheel_radius_walk: Annotated[float, Spec("how fast it may change", "1/sqrt(s)", minimum=0.0, maximum=0.1)] = 1e-4


class FilterOptions(NamedTuple):
    """What a :class:`FilterConfig` means to the filter: plain numbers."""

    adaptive: bool
    gates: tuple[float, float, float]
    """bounds of the NIS of measurements of one, two and three numbers; inf without a gate"""
    relocation_fixes: int
    relocation_timeout: float
    """[s]"""
    radius_variance: float
    """of each wheel's relative radius error at the start; 0 if it is no state"""
    radius_walk: float
    """variance per second that it gains"""
    radius_most: float
    """bound of its estimate"""


def options_of(config: FilterConfig) -> FilterOptions:
    """Work out what a configuration means; the bounds are chi-square quantiles."""
    calibrating = config.filter in (CALIBRATING, FNN_CALIBRATING)
    rest = 1.0 - config.gate_probability
    first, second, third = (float(chdtri(dof, rest)) if rest > 0.0 else math.inf for dof in (1, 2, 3))
    return FilterOptions(
        config.filter in (FNN, FNN_CALIBRATING),
        (first, second, third),
        config.relocation_fixes,
        config.relocation_timeout,
        config.wheel_radius_sigma**2 if calibrating else 0.0,
        config.wheel_radius_walk**2 if calibrating else 0.0,
        max(_MOST_SIGMAS * config.wheel_radius_sigma, _MOST) if calibrating else 0.0,
    )
