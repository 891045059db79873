"""``diffbot stability verify``: gives a file to the checker of its kind."""

from __future__ import annotations

from pathlib import Path

from diffbot_core.errors import DiffbotError
from diffbot_lab.stability import level_file, level_verify, near_commands

_HEAD = 200
"""characters at the beginning of a file in which its format is named"""


def run(path: Path) -> int:
    """Check a certificate again.

    Raises:
        DiffbotError: if the file cannot be read, or naming what is not proved.
    """
    try:
        with path.open(encoding="utf-8") as file:
            head = file.read(_HEAD)
    except (OSError, UnicodeDecodeError) as error:
        raise DiffbotError(f"{path} cannot be read: {error}") from None
    if level_file.FORMAT in head:
        return level_verify.run_verify(path)
    return near_commands.run_verify(path)
