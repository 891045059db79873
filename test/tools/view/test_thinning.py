"""Thinning keeps every peak."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from diffbot_tools.view.thinning import kept_rows


@given(st.integers(0, 2**32), st.integers(100, 5000), st.floats(0.0, 0.9))
def test_the_peaks_of_every_column_stay_whatever_is_missing(seed, n, missing):
    rng = np.random.default_rng(seed)
    columns = np.where(rng.random((n, 3)) < missing, np.nan, rng.normal(size=(n, 3)))
    places = rng.choice(n, 6, replace=False)
    for index, place in enumerate(places):
        columns[place, index % 3] = 100.0 * (-1) ** (index // 3)
    kept = kept_rows(columns, 90)
    assert len(kept) <= 90
    assert set(places) <= set(kept.tolist())
    assert (kept[0], kept[-1]) == (0, n - 1)
    assert np.all(np.diff(kept) > 0)
