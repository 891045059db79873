"""The journal of a campaign: a header that names the campaign and the code, and a line for each finished chunk.

An interrupted campaign resumes from its journal. Lines are only appended, and each carries a checksum. A line that was
cut off or damaged does not count, and its runs are repeated.
"""

from __future__ import annotations

import json
import zlib
from pathlib import Path
from typing import Any

from diffbot_core.errors import DiffbotError
from diffbot_lab.campaign.spec import Campaign, code_version
from diffbot_lab.campaign.statistics import CellStatistics

FORMAT = 3
JOURNAL = "campaign.jsonl"
_SEAL_START = b',"crc32":'
_SEAL = _SEAL_START + b"%d}\n"


def sealed(entry: dict[str, Any]) -> bytes:
    """Return a line of JSON that ends with the checksum of everything before it."""
    body = json.dumps(entry, separators=(",", ":")).encode()[:-1]
    return body + _SEAL % zlib.crc32(body)


def parsed(line: bytes) -> Any:
    """Return the content of a line without its checksum, or None if the checksum is wrong."""
    body, found, seal = line.rpartition(_SEAL_START)
    return json.loads(body + b"}") if found and found + seal == _SEAL % zlib.crc32(body) else None


class Journal:
    """The finished chunks of one campaign, in a file and counted."""

    def __init__(self, path: Path, campaign: Campaign) -> None:
        """Start a journal, or continue the one at ``path``.

        Raises:
            DiffbotError: if the file cannot be written, is not a journal, or belongs to another campaign or another
                version of the code. The file is not changed then.
        """
        self._path, self._campaign = path, campaign
        self.statistics = [CellStatistics() for _ in campaign.cells]
        self.done: set[tuple[int, int]] = set()
        """cell and first run of each finished chunk"""
        self.damaged = 0
        """number of lines that do not count"""
        if path.exists() and not path.is_file():
            raise DiffbotError(f"{path} is not a regular file")
        try:
            # Unbuffered: a failed write would otherwise fail again on closing.
            self._file = path.open("ab", buffering=0)
        except OSError as error:
            raise DiffbotError(f"cannot write {path}: {error.strerror}") from None
        try:
            self._resume()
        except BaseException:
            self._file.close()
            raise

    def _resume(self) -> None:
        campaign, end = self._campaign, b""
        name = {"format": FORMAT, "identity": campaign.identity, "sources": code_version()}
        header = sealed({**name, "campaign": campaign.description})
        with self._path.open("rb") as file:
            start = file.readline()
            if start != header and not header.startswith(start):
                self._refuse(parsed(start), name)
            for end in file:
                self.damaged += not self._count(parsed(end))
        if start != header:  # a kill or a full disk cut it off
            self._write(header[len(start) :])
        elif end and not end.endswith(b"\n"):
            self._write(b"\n")

    def _refuse(self, found: Any, expected: dict[str, Any]) -> None:
        if not isinstance(found, dict) or found.get("format") != FORMAT:
            raise DiffbotError(f"{self._path} is not a journal of a campaign (format {FORMAT}): not touched")
        if found.get("sources") != expected["sources"]:
            raise DiffbotError(f"{self._path} was begun with another version of the code: choose another --out")
        raise DiffbotError(f"{self._path} belongs to another campaign: not touched; choose another --out")

    def _count(self, entry: Any) -> bool:
        """Count a chunk once; return False if the entry is not a chunk of the campaign."""
        if not isinstance(entry, dict) or not {"cell", "first"} <= set(entry):
            return False
        chunk = entry["cell"], entry["first"]
        if chunk not in self.done:
            self.done.add(chunk)
            self.statistics[entry["cell"]].add(entry)
        return True

    def add(self, cell: int, first: int, counts: dict[str, Any]) -> None:
        """Write and count a finished chunk.

        Raises:
            DiffbotError: if the journal cannot be written.
        """
        entry = {"cell": cell, "first": first, **counts}
        self._write(sealed(entry))
        self._count(entry)

    def _write(self, line: bytes) -> None:
        left = memoryview(line)
        try:
            while left:
                left = left[self._file.write(left) :]
        except OSError as error:
            raise DiffbotError(f"cannot write {self._path}: {error.strerror}") from None

    def close(self) -> None:
        """Close the file."""
        self._file.close()
