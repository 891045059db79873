"""What a figure shows: the figure itself instead of its file, and the colours of its pixels."""

import matplotlib.pyplot as plt
import numpy as np
import pytest
from matplotlib.colors import to_rgb


@pytest.fixture
def drawn(monkeypatch):
    """Return a function that replaces a module's ``save`` and returns the list of the figures saved there."""
    figures = []

    def capture(module):
        monkeypatch.setattr(module, "save", lambda figure, *paths: figures.append(figure))
        return figures

    yield capture
    for figure in figures:
        plt.close(figure)


def lines(axes):
    """Return the labelled lines of axes by label."""
    return {line.get_label(): line for line in axes.lines if not line.get_label().startswith("_")}


def same_colour(one, other, tolerance=0.02):
    return np.allclose(to_rgb(one), to_rgb(other), atol=tolerance)
