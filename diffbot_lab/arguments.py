"""Types of command-line arguments."""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable

MAX_SEED = 2**63 - 1


def whole(low: int, high: int) -> Callable[[str], int]:
    """Return a type for argparse: a whole number from ``low`` to ``high``."""

    def whole_number(text: str) -> int:
        number = int(text)
        if not low <= number <= high:
            raise argparse.ArgumentTypeError(f"{text}: must be from {low} to {high}")
        return number

    whole_number.__name__ = "whole number"  # of argparse's message
    return whole_number


def number_between(low: float, high: float) -> Callable[[str], float]:
    """Return a type for argparse: a number from ``low`` to ``high``."""

    def one_number(text: str) -> float:
        value = float(text)
        if not low <= value <= high:
            raise argparse.ArgumentTypeError(f"{text}: must be from {low:g} to {high:g}")
        return value

    one_number.__name__ = "number"  # of argparse's message
    return one_number


def duration(text: str) -> float:
    """Return a time > 0 [s], which may be infinite; a type for argparse."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not value > 0.0:
        raise argparse.ArgumentTypeError(f"{text!r}: must be a time > 0 [s]")
    return value
