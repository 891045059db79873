"""``diffbot campaign``: read, run or resume, report."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Callable, Mapping
from concurrent.futures import Executor
from pathlib import Path
from typing import Any

from diffbot_core.errors import DiffbotError
from diffbot_lab.campaign.report import table, write_report
from diffbot_lab.campaign.runner import (
    JOURNAL,
    Journal,
    campaign_workers,
    cluster_executor,
    process_pool,
    run_campaign,
)
from diffbot_lab.campaign.spec import Campaign, read_campaign


def run(file: Path | None, flags: Mapping[str, Any], out: Path, workers: int | None, scheduler: str | None) -> int:
    """Run or resume the campaign of a YAML file and flags; write its results to ``out``.

    Returns:
        0, or 130 if it was interrupted; finished chunks are kept.

    Raises:
        DiffbotError: for a bad description, another campaign's folder, an unreachable scheduler.
    """
    campaign = read_campaign(file, flags)
    if scheduler is not None:
        with cluster_executor(scheduler) as (make_executor, number):
            return _run_on(make_executor, number, campaign, out)
    number = campaign_workers(workers)
    return _run_on(lambda: process_pool(number), number, campaign, out)


def _run_on(make_executor: Callable[[], Executor], number: int, campaign: Campaign, out: Path) -> int:
    """Run a campaign with ``number`` workers; see :func:`run`."""
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise DiffbotError(f"cannot write to {out}: {error.strerror}") from None
    if not os.access(out, os.W_OK):
        raise DiffbotError(f"cannot write to {out}")
    _refuse_results_of_another(out, campaign)
    journal = Journal(out / JOURNAL, campaign)
    try:
        run_campaign(campaign, journal, make_executor, number)
    except KeyboardInterrupt:
        done, total = sum(one.runs for one in journal.statistics), campaign.options.runs * len(campaign.cells)
        print(f"interrupted: {done} of {total} runs are kept; the same command goes on from there", file=sys.stderr)
        return 130
    finally:
        journal.close()
    print(table(campaign, journal.statistics))
    for path in write_report(campaign, journal.statistics, out):
        print(path)
    return 0


def _refuse_results_of_another(out: Path, campaign: Campaign) -> None:
    """Refuse to overwrite results without a journal, unless they are of this campaign."""
    path = out / "results.json"
    if (out / JOURNAL).exists() or not path.is_file():
        return
    try:
        identity = json.loads(path.read_text())["identity"]
    except (OSError, ValueError, LookupError, TypeError, RecursionError):
        identity = None
    if identity != campaign.identity:
        raise DiffbotError(f"{path} is of another campaign: not touched; choose another --out")
