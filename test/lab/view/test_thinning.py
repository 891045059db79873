"""Thinning keeps every peak; packing keeps every digit that a sensor has. Both against a textbook version here."""

import base64
import struct
import zlib

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from diffbot_lab.view.packing import TIME_UNIT, UNIT, Packer, pack
from diffbot_lab.view.thinning import kept_rows


def test_a_short_table_stays_as_it_is():
    assert kept_rows(np.zeros((10, 2)), 10).tolist() == list(range(10))


@pytest.mark.parametrize("n", [1001, 5000, 99_999])
def test_single_peaks_of_every_column_stay(n):
    rng = np.random.default_rng(n)
    columns = rng.normal(size=(n, 3))
    places = rng.choice(n, 6, replace=False)
    for index, place in enumerate(places):
        columns[place, index % 3] = 100.0 * (-1) ** (index // 3)
    kept = kept_rows(columns, 1000)
    assert len(kept) <= 1000
    assert set(places) <= set(kept.tolist())
    assert kept[0] == 0
    assert kept[-1] == n - 1
    assert np.all(np.diff(kept) > 0)


def test_extremes_of_every_stretch_stay():
    """In each window twice as long as a bucket, the thinned curve reaches the extremes of the full one nearly."""
    t = np.arange(100_000)
    columns = np.column_stack((np.sin(t / 5000.0) + (t % 997 == 0), np.cos(t / 300.0)))
    kept = kept_rows(columns, 4000)
    width = 2 * -(-len(t) // 999)
    for begin in range(0, len(t) - width, 7919):
        inside = kept[(kept >= begin) & (kept < begin + width)]
        assert columns[inside].max(axis=0) == pytest.approx(columns[begin : begin + width].max(axis=0), abs=0.2)
    assert columns[kept].max(axis=0).tolist() == columns.max(axis=0).tolist()


def test_missing_numbers_do_not_hide_a_peak():
    columns = np.full((10_000, 2), np.nan)
    columns[4321, 1] = 5.0
    assert 4321 in kept_rows(columns, 100).tolist()


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


def test_huge_numbers_get_a_coarser_unit():
    values = np.array([1e7, -1e7, 3.0])
    unit, data = pack(values, UNIT)
    assert unit == pytest.approx(1e7 / 2**30)
    assert unpacked(data, unit, 3) == pytest.approx(values, abs=0.51 * unit)


def test_tables_are_found_in_one_text():
    packer = Packer()
    first = packer.table({"t": np.array([0.0, 0.5]), "x": np.array([1.0, 2.0])})
    second = packer.table({"t": np.array([7.25])})
    data = zlib.decompress(base64.b64decode(packer.text()))
    assert first["columns"]["t"]["unit"] == TIME_UNIT
    place = first["columns"]["x"]
    assert unpacked(data[place["at"] :], place["unit"], first["rows"]).tolist() == pytest.approx([1.0, 2.0])
    place = second["columns"]["t"]
    assert unpacked(data[place["at"] :], place["unit"], second["rows"]).tolist() == pytest.approx([7.25])
