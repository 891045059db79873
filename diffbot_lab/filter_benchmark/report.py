"""The table of the filter's benchmark for a terminal."""

from __future__ import annotations

from typing import Any

from diffbot_lab.tables import number

Results = dict[str, Any]


def table(results: Results) -> str:
    """Lay out all cases for a terminal."""
    head = f"{'':<20}{'|pos| [m]: RMSE':>15}{'95 %':>7}{'max':>8}{'|theta| [rad]: RMSE':>21}{'95 %':>8}{'lost':>6}"
    head += f"{'back [s]: median':>18}{'max':>7}{'NIS':>9}{'NEES':>10}{'rejected':>10}{'relocations':>13}"
    rows = [head]
    for case in results["cases"]:
        rows += ["-" * len(head), f"{case['odometry_rate']}/{case['fix_rate']} Hz: {case['text']}"]
        rows += [_terminal_row(name, one) for name, one in case["filters"].items()]
    return "\n".join(rows)


def _terminal_row(name: str, one: Results) -> str:
    position, heading = one["position"], one["heading"]
    return (
        f"{name:<20}{number(position['rmse']):>15}{number(position['p95']):>7}{number(one['largest'], 2):>8}"
        f"{number(heading['rmse'], 4):>21}{number(heading['p95'], 4):>8}{one['lost']:>6}"
        f"{number(one['back_median'], 1):>18}{number(one['back_max'], 1):>7}{number(one['nis'], 2):>9}"
        f"{number(one['nees'], 2):>10}{100.0 * one['rejected']:>8.2f} %{number(one['relocations'], 2):>13}"
    )
