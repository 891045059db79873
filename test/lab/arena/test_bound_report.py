"""Laws that are ahead of NMPC on the estimate are listed, bounds are not."""

import numpy as np

from diffbot_lab.arena.bounds.report import laws_ahead
from diffbot_lab.arena.statistics import figures_of
from diffbot_sim.compiled.batch import COLUMNS


def figures(time, position, settled=40):
    outcomes = np.zeros((40, len(COLUMNS)))
    outcomes[:, COLUMNS.index("settling_time")] = time + 0.1 * np.arange(40)
    outcomes[settled:, COLUMNS.index("settling_time")] = np.nan
    outcomes[:, COLUMNS.index("x")] = position
    return figures_of(outcomes)


def arena(law):
    names = ("switching", "truth")
    laws = [{"name": name, "label": f"law {name}", "bound": name == "truth"} for name in names]
    row = [{"name": "switching"} | law, {"name": "truth"} | figures(1.0, 0.001)]
    return {"laws": laws, "cases": [{"name": "nominal", "laws": row}]}


def test_a_law_ahead_of_nmpc_on_the_estimate_is_listed_and_a_bound_is_not():
    nmpc = [
        {"name": f"nmpc_{feedback}", "label": f"NMPC, {feedback}"} | figures(time, position)
        for feedback, time, position in (("truth", 9.0, 0.01), ("ekf", 10.0, 0.05))
    ]
    bounds = {"cases": [{"name": "nominal", "text": "-", "nmpc": nmpc}]}
    assert laws_ahead(bounds, arena(figures(12.0, 0.06))) == []
    assert laws_ahead(bounds, arena(figures(12.0, 0.04))) == [
        ["nominal", "law switching", "final position error, 95 %", "0.040 m, 0.050 m"]
    ]  # all positions are equal, so the intervals are points
    found = laws_ahead(bounds, arena(figures(9.5, 0.06)))
    assert [row[2] for row in found] == ["settling time, median", "settling time, 99 %"]
    assert [row[3].endswith("(intervals overlap)") for row in found] == [True, False]
    # A law that settles less often is not ahead by the time of the runs that do.
    assert laws_ahead(bounds, arena(figures(9.5, 0.04, settled=20))) == []
