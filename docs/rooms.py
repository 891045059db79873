"""The picture of the rooms, docs/rooms.svg: drawn from the imports of the source, so that it cannot drift from them."""

from __future__ import annotations

import ast
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
FLOORS = (("diffbot_lab",), ("diffbot_tools",), ("diffbot_sim",), ("diffbot_control", "diffbot_bag"), ("diffbot_core",))
"""From the top; imports go downwards, and the packages of one floor do not import each other."""
COLOURS = {
    "diffbot_core": "#777777",
    "diffbot_control": "#0072B2",
    "diffbot_bag": "#009E73",
    "diffbot_sim": "#B8860B",
    "diffbot_tools": "#CC79A7",
    "diffbot_lab": "#D55E00",
}
"""Okabe and Ito's, dark enough for lines on white."""
TOP = {
    "diffbot_core": "base",
    "diffbot_control": "nodes",
    "diffbot_bag": "bags",
    "diffbot_sim": "node and loop",
    "diffbot_tools": "command",
    "diffbot_lab": "cases",
}
"""What stands in a package outside its sub-packages."""
WIDTH, HEIGHT, GAP, FLOOR = 150, 46, 14, 118
"""[px] of a box, between boxes, from floor to floor"""


def room_of(module: str) -> str:
    """Return the room of a module: its sub-package, or else its package."""
    parts = module.split(".")
    return ".".join(parts[:2]) if len(parts) > 1 and ROOT.joinpath(*parts[:2]).is_dir() else parts[0]


def imports_between_rooms() -> tuple[Counter[str], Counter[tuple[str, str]]]:
    """Count the modules of each room, and the import statements from each room into another."""
    modules: Counter[str] = Counter()
    arrows: Counter[tuple[str, str]] = Counter()
    for path in sorted(ROOT.glob("diffbot_*/**/*.py")):
        name = ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")
        room = room_of(name)
        modules[room] += path.name != "__init__.py"
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("diffbot_"):
                # `from package import module` names the module only in the alias.
                for target in {room_of(f"{node.module}.{alias.name}") for alias in node.names} - {room}:
                    arrows[room, target] += 1
    return modules, arrows


def picture() -> str:
    """Return the picture as SVG; arrows to diffbot_core are left out, since every room imports it."""
    modules, arrows = imports_between_rooms()
    centres = _centres(modules)
    width = max(x for x, _ in centres.values()) + WIDTH // 2 + GAP
    height = max(y for _, y in centres.values()) + HEIGHT // 2 + GAP
    lines = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" font-family="sans-serif">',
        f'<rect width="{width}" height="{height}" fill="white"/>',
        *_arrows(arrows, centres),
        *(line for room, (x, y) in centres.items() for line in _box(room, modules[room], x, y)),
        "</svg>",
    ]
    return "\n".join(lines) + "\n"


def _centres(modules: Counter[str]) -> dict[str, tuple[int, int]]:
    floors = [
        [room for package in floor for room in sorted(modules) if room.split(".")[0] == package] for floor in FLOORS
    ]
    longest = max(map(len, floors))
    found = {}
    for level, rooms in enumerate(floors):
        left = GAP + WIDTH // 2 + (longest - len(rooms)) * (WIDTH + GAP) // 2
        for index, room in enumerate(rooms):
            found[room] = (left + index * (WIDTH + GAP), 70 + level * FLOOR)
    return found


def _box(room: str, count: int, x: int, y: int) -> Iterator[str]:
    package, _, name = room.partition(".")
    colour = COLOURS[package]
    corner = f'x="{x - WIDTH // 2}" y="{y - HEIGHT // 2}" width="{WIDTH}" height="{HEIGHT}" rx="6"'
    yield f'<rect {corner} fill="white" stroke="{colour}" stroke-width="2"/>'
    title = name or TOP[package]
    yield f'<text x="{x}" y="{y - 3}" text-anchor="middle" font-size="13" font-weight="bold">{title}</text>'
    plural = "s" if count != 1 else ""
    yield f'<text x="{x}" y="{y + 14}" text-anchor="middle" font-size="10">{package}, {count} module{plural}</text>'


def _arrows(arrows: Counter[tuple[str, str]], centres: dict[str, tuple[int, int]]) -> Iterator[str]:
    yield "<defs>"
    for package, colour in COLOURS.items():
        head = f'<path d="M0 0L8 4L0 8z" fill="{colour}"/>'
        size = 'viewBox="0 0 8 8" refX="7" refY="4" markerWidth="7" markerHeight="7" markerUnits="userSpaceOnUse"'
        yield f'<marker id="{package}" {size} orient="auto">{head}</marker>'
    yield "</defs>"
    for (source, target), count in sorted(arrows.items()):
        if target == "diffbot_core":
            continue
        (x, y), (to_x, to_y) = centres[source], centres[target]
        package = source.split(".")[0]
        top = to_y - HEIGHT // 2 - 1
        if y == to_y:
            lift = top - 12 - abs(to_x - x) // 14
            path = f"M{x} {top}C{x} {lift} {to_x} {lift} {to_x} {top}"
        else:
            path = f"M{x} {y + HEIGHT // 2}L{to_x} {top}"
        style = f'stroke="{COLOURS[package]}" stroke-width="{0.7 + 0.15 * min(count, 12):.2f}" opacity="0.55"'
        yield f'<path d="{path}" fill="none" {style} marker-end="url(#{package})"/>'
