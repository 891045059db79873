"""Journal of a campaign: a header that identifies the campaign and the code, and a line for each finished chunk.

An interrupted campaign resumes from its journal. Lines are only appended, and each line ends with a checksum.
Incomplete and damaged lines are ignored, and their runs are repeated.
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
_CHECKSUM_START = b',"crc32":'
_CHECKSUM = _CHECKSUM_START + b"%d}\n"


def encode_line(entry: dict[str, Any]) -> bytes:
    """Return a line of JSON whose last value is the checksum of the text before it."""
    body = json.dumps(entry, separators=(",", ":")).encode()[:-1]
    return body + _CHECKSUM % zlib.crc32(body)


def decode_line(line: bytes) -> Any:
    """Return the content of a line, or None if its checksum is wrong."""
    body, found, checksum = line.rpartition(_CHECKSUM_START)
    return json.loads(body + b"}") if found and found + checksum == _CHECKSUM % zlib.crc32(body) else None


class Journal:
    """The finished chunks of a campaign: their file and their statistics."""

    def __init__(self, path: Path, campaign: Campaign) -> None:
        """Create a journal, or continue the journal at ``path``.

        Raises:
            DiffbotError: if the file cannot be written, is not a journal, or belongs to another campaign or to another
                version of the code. The file is not changed.
        """
        self._path, self._campaign = path, campaign
        self.statistics = [CellStatistics() for _ in campaign.cells]
        self.done: set[tuple[int, int]] = set()
        """cell and first run of each finished chunk"""
        self.damaged = 0
        """number of damaged lines, which are ignored"""
        if path.exists() and not path.is_file():
            raise DiffbotError(f"{path} is not a regular file, so it cannot be a journal: choose another --out")
        try:
            # Unbuffered, because close() would try to write the buffer again after a failed write.
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
        header = encode_line({**name, "campaign": campaign.description})
        with self._path.open("rb") as file:
            start = file.readline()
            if start != header and not header.startswith(start):
                self._refuse(decode_line(start), name)
            for end in file:
                self.damaged += not self._count(decode_line(end))
        if start != header:  # the file is empty, or the header was not written completely
            self._write(header[len(start) :])
        elif end and not end.endswith(b"\n"):
            self._write(b"\n")

    def _refuse(self, found: Any, expected: dict[str, Any]) -> None:
        if not isinstance(found, dict) or found.get("format") != FORMAT:
            raise DiffbotError(f"{self._path} is not a journal of a campaign (format {FORMAT}): choose another --out")
        if found.get("sources") != expected["sources"]:
            raise DiffbotError(f"{self._path} was written by another version of the code: choose another --out")
        raise DiffbotError(f"{self._path} belongs to another campaign: choose another --out")

    def _count(self, entry: Any) -> bool:
        """Add a chunk to the statistics if it is new. Return False if the entry is not a chunk."""
        if not isinstance(entry, dict) or not {"cell", "first"} <= set(entry):
            return False
        chunk = entry["cell"], entry["first"]
        if chunk not in self.done:
            self.done.add(chunk)
            self.statistics[entry["cell"]].add(entry)
        return True

    def add(self, cell: int, first: int, counts: dict[str, Any]) -> None:
        """Write a finished chunk and add it to the statistics.

        Raises:
            DiffbotError: if the journal cannot be written.
        """
        entry = {"cell": cell, "first": first, **counts}
        self._write(encode_line(entry))
        self._count(entry)

    def _write(self, line: bytes) -> None:
        rest = memoryview(line)
        try:
            while rest:
                rest = rest[self._file.write(rest) :]
        except OSError as error:
            raise DiffbotError(f"cannot write {self._path}: {error.strerror}") from None

    def close(self) -> None:
        """Close the file."""
        self._file.close()
