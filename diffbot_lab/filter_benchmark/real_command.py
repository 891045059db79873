"""The filter on real drives, and calibrated on them: ``diffbot benchmark real``."""

from __future__ import annotations

import tempfile
from pathlib import Path

from tqdm import tqdm

from diffbot_core.files import output_folder, write_json, write_text
from diffbot_lab.filter_benchmark.real_calibration import calibrated_table, study
from diffbot_lab.filter_benchmark.real_drives import drives_in, evaluate, results_of, table


def run_and_report(data: Path, out: Path, figures: bool, *, calibrated: bool = False) -> int:
    """Evaluate all drives of a folder; write results.json, table.md and a figure per drive to ``out``.

    Args:
        data: folder of a data set.
        out: folder for the results.
        figures: draw each drive.
        calibrated: calibrate on the first third of each drive, too.

    Raises:
        DiffbotError: if the folder holds no known data set, a file is bad, or ``out`` cannot be written.
    """
    readers = drives_in(data)
    with output_folder(out):
        with tempfile.TemporaryDirectory() as folder:
            bar = tqdm(readers, desc="filter", unit="drive", disable=None)
            found = [evaluate(read(), Path(folder)) for read in bar]
            results = results_of(found)
            text = table(results)
            if calibrated:
                results["calibrated"] = study(found, Path(folder))
                text += "\n\n" + calibrated_table(results["calibrated"])
        write_json(out / "results.json", results)
        write_text(out / "table.md", text + "\n")
        if figures:
            # Loads matplotlib.
            from diffbot_lab.filter_benchmark.real_figure import draw_drive  # noqa: PLC0415

            for one in found:
                draw_drive(one.name, one.errors, out / f"{one.name.replace(' ', '_')}.png")
    print(text)
    print(f"Results in {out}")
    return 0
