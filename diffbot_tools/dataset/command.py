"""``diffbot import``: a data set that the user has downloaded to a bag."""

from __future__ import annotations

import os
from pathlib import Path

from diffbot_core.errors import DiffbotError
from diffbot_tools.dataset.bag import EKF_FILE, write_drive
from diffbot_tools.dataset.drive import Drive, duration
from diffbot_tools.dataset.labyrinth import read_labyrinth
from diffbot_tools.dataset.mrclam import read_mrclam


def import_mrclam(folder: Path, robot: int, out: Path) -> int:
    """Write the bag of one robot of a set of MR.CLAM.

    Raises:
        DiffbotError: for missing or bad files, and if ``out`` exists already or cannot be written.
    """
    _refuse_existing(out)
    return _write(read_mrclam(folder, robot), out)


def import_labyrinth(folder: Path, out: Path) -> int:
    """Write the bag of the Labyrinth data set.

    Raises:
        DiffbotError: for missing or bad files, and if ``out`` exists already or cannot be written.
    """
    _refuse_existing(out)
    return _write(read_labyrinth(folder), out)


def _refuse_existing(out: Path) -> None:
    # Before the files are read, which takes seconds.
    if os.path.lexists(out):
        raise DiffbotError(f"{out} exists already: choose another name for the bag")


def _write(drive: Drive, out: Path) -> int:
    count = write_drive(drive, out)
    for note in drive.notes:
        print(note)
    print(f"{count} messages, {duration(drive):.1f} s of odometry, {len(drive.landmarks)} landmarks")
    print(f"{out}\n{out / EKF_FILE}")
    return 0
