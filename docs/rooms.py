"""The picture of the rooms, docs/rooms.svg: drawn from the imports of the source, so that it cannot drift from them."""

from __future__ import annotations

import ast
from collections import Counter
from pathlib import Path

import matplotlib
import matplotlib.pyplot as plt
from matplotlib.patches import FancyArrowPatch, FancyBboxPatch

ROOT = Path(__file__).resolve().parent.parent
FLOORS = (("diffbot_core",), ("diffbot_control", "diffbot_bag"), ("diffbot_sim",), ("diffbot_lab",))
"""From the ground up; packages of one floor do not know each other."""
_COLOURS = {
    "diffbot_core": "#999999",
    "diffbot_control": "#0072B2",
    "diffbot_bag": "#009E73",
    "diffbot_sim": "#E69F00",
    "diffbot_lab": "#D55E00",
}
_TOP = {
    "diffbot_core": "base",
    "diffbot_control": "nodes",
    "diffbot_bag": "bags",
    "diffbot_sim": "node, reference loop",
    "diffbot_lab": "command",
}
"""What stands in a package beside its sub-packages."""
_WIDTH, _HEIGHT, _GAP = 1.75, 0.62, 0.22


def room_of(module: str) -> str:
    """Return the room of a module: its sub-package, or else its package."""
    parts = module.split(".")
    folder = ROOT.joinpath(*parts[:2])
    return ".".join(parts[:2]) if len(parts) > 1 and folder.is_dir() else parts[0]


def imports_between_rooms() -> tuple[dict[str, int], Counter[tuple[str, str]]]:
    """Count the modules of each room, and the imports from each room into another, wherever an import stands."""
    modules: Counter[str] = Counter()
    arrows: Counter[tuple[str, str]] = Counter()
    for path in sorted(ROOT.glob("diffbot_*/**/*.py")):
        name = ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")
        room = room_of(name)
        modules[room] += path.name != "__init__.py"
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("diffbot_"):
                # `from package import module` names the module only in the alias.
                targets = {room_of(f"{node.module}.{alias.name}") for alias in node.names}
                for target in targets - {room}:
                    arrows[room, target] += 1
    return dict(modules), arrows


def places(rooms: dict[str, int]) -> dict[str, tuple[float, float]]:
    """Return the centre of each room's box: floors above each other, the rooms of a floor side by side."""
    found: dict[str, tuple[float, float]] = {}
    for level, packages in enumerate(FLOORS):
        row = [room for package in packages for room in sorted(rooms) if room.split(".")[0] == package]
        left = -0.5 * (len(row) - 1) * (_WIDTH + _GAP)
        for index, room in enumerate(row):
            found[room] = (left + index * (_WIDTH + _GAP), 1.7 * level)
    return found


def draw(path: Path) -> None:
    """Write the picture, the same bytes for the same source, without the arrows to diffbot_core, from everywhere."""
    rooms, arrows = imports_between_rooms()
    centres = places(rooms)
    with matplotlib.rc_context({"svg.hashsalt": "diffbot", "svg.fonttype": "none", "font.size": 9}):
        figure, axes = plt.subplots(figsize=(11.0, 5.8), layout="constrained")
        for (source, target), count in sorted(arrows.items()):
            if target == "diffbot_core":
                continue  # every room uses it: the arrows would hide the others
            _arrow(axes, centres[source], centres[target], count, _COLOURS[source.split(".")[0]])
        for room, (x, y) in centres.items():
            _box(axes, room, rooms[room], x, y)
        xs = [x for x, _ in centres.values()]
        axes.set_xlim(min(xs) - _WIDTH, max(xs) + _WIDTH)
        axes.set_ylim(-0.5, 1.7 * (len(FLOORS) - 1) + 1.2)
        axes.axis("off")
        figure.savefig(path, format="svg", metadata={"Date": None})
        plt.close(figure)


def _box(axes: plt.Axes, room: str, count: int, x: float, y: float) -> None:
    package, _, name = room.partition(".")
    corner = (x - 0.5 * _WIDTH, y - 0.5 * _HEIGHT)
    box = FancyBboxPatch(corner, _WIDTH, _HEIGHT, boxstyle="round,pad=0.02", facecolor="white", linewidth=1.6)
    box.set_edgecolor(_COLOURS[package])
    axes.add_patch(box)
    axes.text(x, y + 0.12, name or _TOP[package], ha="center", va="center", fontweight="bold")
    label = f"{package}, {count} modules"
    axes.text(x, y - 0.15, label, ha="center", va="center", fontsize=7)


def _arrow(axes: plt.Axes, start: tuple[float, float], end: tuple[float, float], count: int, colour: str) -> None:
    same_floor = start[1] == end[1]
    lift = 0.5 * _HEIGHT
    foot = (start[0], start[1] + lift if same_floor else start[1] - lift)
    head = (end[0], end[1] + lift)
    bend = -0.25 if same_floor and end[0] > start[0] else 0.25 if same_floor else 0.0
    axes.add_patch(
        FancyArrowPatch(
            foot,
            head,
            connectionstyle=f"arc3,rad={bend}",
            arrowstyle="-|>",
            mutation_scale=9,
            linewidth=0.5 + 0.12 * min(count, 20),
            color=colour,
            alpha=0.55,
            zorder=0,
        )
    )
