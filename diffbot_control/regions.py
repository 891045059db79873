"""Which law is in force: the regions Omega_G (far) and Omega_L (near), and the policies that switch between them."""

from __future__ import annotations

import math
from typing import Annotated, NamedTuple

from diffbot_control.config import Spec
from diffbot_control.errors import InvalidValueError

OMEGA_G = 0
OMEGA_L = 1
REGION_NAMES = ("Omega_G", "Omega_L")


class FixedRegion(NamedTuple):
    """Omega_L as a circle of constant radius about the goal, with hysteresis.

    The default radius meets the paper's condition with its raw noise: sqrt(0.3^2 + 0.3^2) + 0.065 / 1.3 = 0.474 m.
    """

    eps_P: Annotated[
        float, Spec("Omega_L is entered below this distance; 0: never, law (13) everywhere", "m", minimum=0.0)
    ] = 0.5
    eps_P_leave: Annotated[float, Spec("Omega_L is left above this distance", "m", minimum=0.0)] = 0.6

    def check(self) -> None:
        """Refuse a leaving radius below the entering one: the region would flicker.

        Raises:
            InvalidValueError: if it is.
        """
        if self.eps_P_leave < self.eps_P:
            raise InvalidValueError("eps_P_leave", self.eps_P_leave, f">= eps_P = {self.eps_P:g}")


def fixed_region(region: int, rho: float, policy: FixedRegion) -> int:
    """Return the region at distance ``rho`` [m] when ``region`` was the one before."""
    if region == OMEGA_L:
        return OMEGA_L if rho <= policy.eps_P_leave else OMEGA_G
    return OMEGA_L if rho < policy.eps_P else OMEGA_G


def smallest_radius(eps_x: float, eps_y: float, eps_v: float, gamma: float) -> float:
    """The bound that eps_P has to exceed: |eps_rho| + |eps_v| / gamma (paper, section 3.2).

    Args:
        eps_x: [m] bound of the error of x.
        eps_y: [m] bound of the error of y; together |eps_rho| <= hypot(eps_x, eps_y).
        eps_v: [m/s] bound of the velocity noise.
        gamma: [m/s].
    """
    return math.hypot(eps_x, eps_y) + eps_v / gamma
