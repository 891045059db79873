"""A loop with little noise that has a certificate with few cells."""

import functools

from diffbot_lab.stability.certificate_file import EULER, Loop
from diffbot_lab.stability.certify import Resolution, certify

LAW_13 = Loop(1.3, 1.5, 0.17, 2.0, 0.0, 0.0, 0.05, 0.05, 0.05, 0.02, 0.05, 0.2, EULER)
LAW_17 = LAW_13._replace(eps_P=0.35, eps_P_leave=0.4)
PAPER_13 = Loop(1.3, 1.0, 0.17, 2.7, 0.0, 0.0, 0.3, 0.3, 0.17, 0.065, 0.2167, 0.1, EULER)
PAPER_17 = PAPER_13._replace(eps_P=0.5, eps_P_leave=0.5)
COARSE = Resolution(width=0.05, columns=80, growth=0.0, slice_width=0.1, fine_to=9.0)
START = 2.0


@functools.cache
def coarse_certificate(loop):
    """Return the certificate of such a loop."""
    return certify(loop, START, COARSE, threads=1)[0]
