"""Reading a bag with a progress bar."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from tqdm import tqdm

from diffbot_bag.tools.bag_info import BagInfo, Observer, read_info


def read_with_bar(path: Path, *, quick: bool = False, observers: Mapping[str, Observer] | None = None) -> BagInfo:
    """Do what read_info does, with a bar on a terminal for what takes longer than a second.

    Raises:
        DiffbotError: if it is no bag, or is damaged.
    """
    if quick:
        return read_info(path, quick=True)
    total = read_info(path, quick=True).message_count
    with tqdm(desc=path.name, total=total, unit="message", unit_scale=True, disable=None, delay=1.0) as bar:
        return read_info(path, progress=bar.update, observers=observers)
