"""A search that was interrupted goes on from the ranks that it had found, and from nothing else."""

import numpy as np
import pytest

from diffbot_control.law.configuration import ControllerConfig
from diffbot_core.errors import DiffbotError
from diffbot_lab.stability.tuned import certify as maker
from diffbot_lab.stability.tuned.kept_ranks import KeptRanks


def test_after_ctrl_c_the_search_goes_on_and_finds_the_same(monkeypatch, certificate, plan, tmp_path):
    state, usual, calls = tmp_path / "state", maker.rank_kernel, []

    def interrupted(*arguments):
        calls.append(1)
        if len(calls) > 60:
            raise KeyboardInterrupt
        return usual(*arguments)

    monkeypatch.setattr(maker, "rank_kernel", interrupted)
    with pytest.raises(KeyboardInterrupt):
        maker.certify(ControllerConfig(), plan, state=state)
    monkeypatch.setattr(maker, "rank_kernel", usual)
    with np.load(state) as kept:
        ranked = int((kept["ranks"] > 0).sum())
    assert 0 < ranked < int((certificate.ranks > 0).sum())
    monkeypatch.setattr(maker, "_spread", None)  # what was found is not worked out again
    again = maker.certify(ControllerConfig(), plan, state=state)
    np.testing.assert_array_equal(again.ranks, certificate.ranks)


def test_ranks_of_another_calculation_and_a_damaged_file_are_refused(tmp_path):
    KeptRanks(tmp_path / "state", "task", 3).save(np.zeros(3, np.int16))
    for task, cells in (("other", 3), ("task", 4)):
        with pytest.raises(DiffbotError, match="is of another certificate"):
            KeptRanks(tmp_path / "state", task, cells)
    (tmp_path / "state").write_bytes(b"PK\x03\x04")
    with pytest.raises(DiffbotError, match=r"state cannot be read: .*; delete it to start again$"):
        KeptRanks(tmp_path / "state", "task", 3)
