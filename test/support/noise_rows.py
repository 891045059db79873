"""Noise of one step of the plant with given numbers."""

from diffbot_sim.noise import MOTION, quiet_noise


def noise_row(*numbers, purpose=MOTION):
    """Return the noise (purposes, 4) of a step that is zero except for numbers in (-1, 1) of one purpose."""
    row = quiet_noise(2)[:, 0].copy()
    row[purpose, : len(numbers)] = [0.5 * (number + 1.0) for number in numbers]
    return row
