"""Ranks that were found before an interruption.

A rank that has been found stays: it says that a cell leads to smaller ranks only. So the search goes on from them.
"""

from __future__ import annotations

import time
import zipfile
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from diffbot_core.errors import DiffbotError
from diffbot_core.files import replacing
from diffbot_lab.stability.code_name import name_of_code

_SAVED_EVERY = 30.0
"""[s]"""


class KeptRanks:
    """The file that an interrupted search goes on from."""

    def __init__(self, path: Path | None, task: str, cells: int) -> None:
        """Read the file, if there is one.

        Args:
            path: of the file; None: nothing is kept.
            task: text that is different for each calculation.
            cells: how many there are.

        Raises:
            DiffbotError: if the file is of another calculation or of other code, or cannot be read.
        """
        self._path = path
        self._name = f"{name_of_code()} {cells} {task}"
        self._saved = time.monotonic()
        self.ranks = None if path is None or not path.exists() else self._read(path, cells)
        """(cells,) as they were kept; None for none"""

    def _read(self, path: Path, cells: int) -> NDArray[np.int16]:
        try:
            with path.open("rb") as file, np.load(file, allow_pickle=False) as saved:
                if str(saved["name"]) != self._name:
                    raise DiffbotError(f"{path} is of another certificate or of other code; delete it to start again")
                ranks = np.asarray(saved["ranks"])
        except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile) as error:
            raise DiffbotError(f"{path} cannot be read: {error}; delete it to start again") from None
        if ranks.dtype != np.int16 or ranks.shape != (cells,):
            raise DiffbotError(f"{path} cannot be read: no ranks of {cells} cells; delete it to start again")
        return ranks

    def save(self, ranks: NDArray[np.int16]) -> None:
        """Write the file.

        Raises:
            OSError: if it cannot be written.
        """
        if self._path is not None:
            with replacing(self._path) as part, part.open("wb") as file:
                np.savez(file, name=np.array(self._name), ranks=ranks)
        self._saved = time.monotonic()

    def save_now_and_then(self, ranks: NDArray[np.int16]) -> None:
        """Write the file if that was not done for a while."""
        if time.monotonic() - self._saved > _SAVED_EVERY:
            self.save(ranks)
