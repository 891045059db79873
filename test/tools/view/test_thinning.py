"""Thinning keeps every peak; packing keeps every digit that a sensor has. Both against a textbook version here."""

import base64
import struct
import zlib

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from diffbot_tools.view.packing import TIME_UNIT, UNIT, Packer, pack
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


def unpacked(data, unit, rows):
    """The page's way, by hand: four planes of bytes, differences modulo 2^32, the smallest number for missing."""
    values, total = [], 0
    for row in range(rows):
        low = bytes(data[row + plane * rows] for plane in range(4))
        total = (total + struct.unpack("<I", low)[0]) & 0xFFFFFFFF
        signed = total - 2**32 if total >= 2**31 else total
        values.append(float("nan") if signed == -(2**31) else signed * unit)
    return np.array(values)


@given(st.lists(st.floats(-2000.0, 2000.0) | st.just(float("nan")) | st.just(float("inf")), min_size=1, max_size=50))
def test_packed_numbers_come_back(values):
    unit, data = pack(np.array(values), UNIT)
    expected = np.where(np.isfinite(values), values, np.nan)
    assert unpacked(data, unit, len(values)) == pytest.approx(expected, abs=0.5001 * UNIT, nan_ok=True)


def test_tables_are_found_in_one_text_and_huge_numbers_get_a_coarser_unit():
    packer = Packer()
    first = packer.table({"t": np.array([0.0, 0.5]), "x": np.array([1e7, -1e7])})
    second = packer.table({"t": np.array([7.25])})
    data = zlib.decompress(base64.b64decode(packer.text()))
    place = first["columns"]["x"]
    assert place["unit"] == pytest.approx(1e7 / 2**30)
    assert unpacked(data[place["at"] :], place["unit"], first["rows"]) == pytest.approx([1e7, -1e7], abs=0.01)
    place = second["columns"]["t"]
    assert place["unit"] == TIME_UNIT
    assert unpacked(data[place["at"] :], place["unit"], second["rows"]).tolist() == pytest.approx([7.25])
