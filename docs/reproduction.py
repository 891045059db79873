"""The page docs/reproduction.md, written from the results of the experiments so that it cannot drift from them."""

from __future__ import annotations

from typing import Any, NamedTuple

from diffbot_control.law import PAPER_GAINS, smallest_radius
from diffbot_lab.paper.experiment import PAPER_END_STATES, SETTINGS

Results = dict[str, Any]


def _radius_condition() -> float:
    """Smallest eps_P [m] that the paper's condition allows with its own noise."""
    raw = next(setting for setting in SETTINGS if setting.name == "raw")
    noise = raw.sensors
    return smallest_radius(noise.eps_x_max, noise.eps_y_max, raw.plant.eps_v_max, PAPER_GAINS.gamma)


class Statement(NamedTuple):
    """Something the page says, and whether the results bear it out."""

    text: str
    holds: bool


def statements(a: Results, b: Results) -> list[Statement]:
    """Check what the paper claims, and what this project says of it, against the results of A and B."""
    group = {(one["law"], one["setting"]): one for one in a["groups"]}
    noisy = [one for one in (*a["groups"], *b["groups"]) if one["setting"] != "quiet"]
    raw_13, raw_17 = group["law 13", "raw"], group["law 17", "raw"]
    literal, ours = (b["literal_rear_sector"][f"raw {reading}"] for reading in ("as printed", "our reading"))
    return [
        Statement(
            "|v| never exceeds gamma = 1.3 m/s",
            all(one["max_speed"] <= 1.3 for one in (*a["groups"], *b["groups"])),
        ),
        Statement(
            "Law (13) brings the position near the goal and leaves the heading anywhere (raw noise: p95 of |theta| above "
            "2 rad, p95 of |position| below 0.2 m)",
            raw_13["abs_theta"]["0.95"] > 2.0 and raw_13["position"]["0.95"] < 0.2,
        ),
        Statement(
            "Law (17) brings |theta| near 0 (median below 0.1 rad in every noisy group)",
            all(one["abs_theta"]["0.5"] < 0.1 for one in noisy if one["law"] == "law 17"),
        ),
        Statement(
            "Law (17) leaves a lateral error (median |position| above 0.1 m), noise or none",
            raw_17["position"]["0.5"] > 0.1 and group["law 17", "quiet"]["position"]["0.5"] > 0.1,
        ),
        Statement(
            "B: all 16 starts reach the local region in all runs",
            all(one["reached_local_region"] == one["runs"] for one in b["groups"]),
        ),
        Statement(
            "With the rear sector's velocity as printed the robot does not come to the goal (raw noise: median |position| "
            "more than twice that of our reading)",
            literal["position"]["0.5"] > 2.0 * ours["position"]["0.5"],
        ),
    ]


def page(a: Results, b: Results) -> str:
    """Return docs/reproduction.md."""
    lines = [
        "# The paper's experiments, reproduced",
        "",
        "Made by `make docs` from docs/reproduction.json, which `make docs ARGS=--experiments` makes anew.",
        f"Simulations A and B of section 4.2, {a['runs']} runs of each start, seed {a['seed']}, "
        f"{a['steps'] * a['sampling_time']:.0f} s at {a['sampling_time']} s; eps_P = {a['eps_P']} m without hysteresis "
        f"(the paper states a condition, met from {_radius_condition():.3f} m on, and no value, nor how long its runs are).",
        "`diffbot experiment a` and `b` draw figures 4 to 15.",
        "",
        *(f"- **{setting.name}**: {setting.text}" for setting in SETTINGS),
        "",
        "![Figure 7: paths under law (17), raw noise](figure_07_path.png)",
        "![Figure 10: paths from the circle, raw noise](figure_10_path.png)",
        "",
        "## A: end states, and the paper's single runs among ours",
        "",
        *_table_a(a),
        "",
        *_paper_text(a),
        "",
        "## A and B: how far from the goal",
        "",
        *_table_distances(a, b),
        "",
        "## What was checked",
        "",
        "| statement | holds in these results |",
        "|---|---|",
        *(f"| {one.text.replace('|', chr(92) + '|')} | {'yes' if one.holds else 'NO'} |" for one in statements(a, b)),
        "",
        "## What does not hold as printed",
        "",
        *_literal_text(b),
    ]
    return "\n".join(lines) + "\n"


def _table_a(a: Results) -> list[str]:
    rows = [
        "| law | setting | quantity | paper | median | 5 % | 95 % | inside our 1 to 99 % | share of our runs below it |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for one in a["groups"]:
        if "paper" not in one:
            continue
        for name, unit in (("x", "m"), ("y", "m"), ("theta", "rad")):
            ours, paper = one[name], one["paper"][name]
            inside = "yes" if paper["inside_1_99"] else "**no**"
            rows.append(
                f"| {one['law']} | {one['setting']} | {name} [{unit}] | {paper['value']:.4f} | {ours['0.5']:.4f} "
                f"| {ours['0.05']:.4f} | {ours['0.95']:.4f} | {inside} | {100.0 * paper['share_below']:.0f} % |"
            )
    return rows


def _paper_text(a: Results) -> list[str]:
    raw = [one for one in a["groups"] if one["setting"] == "raw"]
    outside = [(one, name) for one in raw for name in ("x", "y", "theta") if not one["paper"][name]["inside_1_99"]]
    if not outside:
        return ["With the paper's noise (raw) all its end states lie inside our 1 to 99 % range."]
    lines = ["With the paper's noise (raw) these end states lie outside our 1 to 99 % range:", ""]
    for one, name in outside:
        value = PAPER_END_STATES[one["law"]][["x", "y", "theta"].index(name)]
        lines.append(
            f"- {one['law']}, {name} = {value:.4f}: {100.0 * one['paper'][name]['share_below']:.0f} % of ours are below "
            f"it, and {100.0 * one['paper'][name]['magnitude_share_below']:.0f} % have a smaller magnitude."
        )
    lines += [
        "",
        "The lateral error y of law (17) is what is left when Omega_L is entered, and nothing removes it afterwards. From "
        "the start of A the robot comes from below, so ours is negative in all runs; the paper's is positive, and smaller "
        "than most. Its radius eps_P, its region rule under noise and the length of its runs are not given, and each of "
        "them moves this number; its sign would also follow from a mirrored y axis.",
    ]
    return lines


def _table_distances(a: Results, b: Results) -> list[str]:
    rows = [
        "| experiment | setting | runs | reached Omega_L | \\|position\\| [m]: median | 95 % | \\|theta\\| [rad]: median | 95 % "
        "| path [m]: median | max \\|v\\| [m/s] |",
        "|---|---|---|---|---|---|---|---|---|---|",
    ]
    for results in (a, b):
        for one in results["groups"]:
            rows.append(
                f"| {results['experiment'].upper()}, {one['label']} | {one['setting']} | {one['runs']} "
                f"| {one['reached_local_region']} | {one['position']['0.5']:.3f} | {one['position']['0.95']:.3f} "
                f"| {one['abs_theta']['0.5']:.3f} | {one['abs_theta']['0.95']:.3f} | {one['path_length']['0.5']:.2f} "
                f"| {one['max_speed']:.4f} |"
            )
    rows += ["", "Law (13) has no Omega_L: its radius is set to 0."]
    return rows


def _literal_text(b: Results) -> list[str]:
    rows = [
        "**Rear sector.** The paper gives v the opposite sign for a goal behind the robot, in a forward direction that it has",
        "turned round. Used as the velocity along the robot's real axis that sign drives away from the goal. End states of B:",
        "",
        "| reading | \\|position\\| [m]: median | 95 % | \\|theta\\| [rad]: median | 95 % |",
        "|---|---|---|---|---|",
    ]
    for name, one in b["literal_rear_sector"].items():
        position, theta = one["position"], one["abs_theta"]
        rows.append(
            f"| {name} | {position['0.5']:.3f} | {position['0.95']:.3f} | {theta['0.5']:.3f} | {theta['0.95']:.3f} |"
        )
    rows += [
        "",
        "**Asymptotic stability of the position.** Every point (0, y, 0) is an equilibrium of the law in Omega_L; see the",
        "lateral error above, without noise too. **Stopping distance.** 1e-5 m is reached only by law (13) without noise.",
        "[control.md](control.md) has the rest.",
    ]
    return rows
