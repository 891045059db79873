"""The layout for Foxglove and Lichtblick: its panels are arranged, and its indices of the law carry their names."""

import json
from pathlib import Path

from diffbot_tools.view.bag_tables import LAW_COLUMNS

LAYOUT = json.loads((Path(__file__).parents[3] / "config" / "foxglove.json").read_text())


def test_its_indices_of_the_law_carry_their_names():
    paths = [path for panel in LAYOUT["configById"].values() for path in panel.get("paths", ())]
    found = {
        path["label"].split()[0]: LAW_COLUMNS[int(path["value"][-2])]
        for path in paths
        if path["value"].startswith("/controller/navigation")
    }
    assert len(found) == 6
    assert all(label == name for label, name in found.items())
