"""The layout for Foxglove and Lichtblick: its panels are arranged, its topics exist, its indices are the right ones."""

import json
import re
from pathlib import Path

from diffbot_lab.view.bag_tables import LAW_COLUMNS

ROOT = Path(__file__).parents[3]
LAYOUT = json.loads((ROOT / "config" / "foxglove.json").read_text())


def leaves(node):
    return [node] if isinstance(node, str) else leaves(node["first"]) + leaves(node["second"])


def texts(value):
    if isinstance(value, dict):
        return [text for one in (*value, *value.values()) for text in texts(one)]
    if isinstance(value, list):
        return [text for one in value for text in texts(one)]
    return [value] if isinstance(value, str) else []


def test_every_panel_is_arranged_once():
    assert sorted(leaves(LAYOUT["layout"])) == sorted(LAYOUT["configById"])


def test_its_topics_are_those_of_the_graph():
    page = (ROOT / "docs/reference/nodes/index.md").read_text()
    known = {name for row in re.findall(r"^\| ([\w/, ]+) \|", page, re.MULTILINE) for name in row.split(", ")}
    named = {re.match(r"/[\w/]+", text)[0] for text in texts(LAYOUT["configById"]) if text.startswith("/")}
    assert len(named) >= 12
    assert {name for name in named if name.lstrip("/") not in known | {"diagnostics"}} - {"/diagnostics"} == set()


def test_its_indices_of_the_law_carry_their_names():
    paths = [path for panel in LAYOUT["configById"].values() for path in panel.get("paths", ())]
    found = {
        path["label"].split()[0]: LAW_COLUMNS[int(path["value"][-2])]
        for path in paths
        if path["value"].startswith("/controller/navigation")
    }
    assert len(found) == 6
    assert all(label == name for label, name in found.items())
