"""Compare two presets of the law in a Monte-Carlo study of 2000 drives each, with the filter in the loop, without ROS.

    python examples/monte_carlo.py [RUNS]

Needs the extra `batch`. Writes monte_carlo.png. The first run compiles the closed loop, which takes up to a minute;
later runs load the machine code from the disk.
"""

import math
import sys

import matplotlib.pyplot as plt
import numpy as np

from diffbot_control.law import PRESETS
from diffbot_lab.cases import configure, make_case
from diffbot_sim.batch import COLUMNS, Starts, run_batch

words = sys.argv[1:] or ["2000"]
if len(words) > 1 or not words[0].isdecimal() or not 1 <= int(words[0]) <= 1_000_000:
    sys.exit(f"RUNS = {' '.join(words)}: must be one whole number from 1 to 1000000")
RUNS = int(words[0])
SEED = 1
ANYWHERE = Starts(np.zeros((1, 3)), half=(5.0, 5.0, math.pi))  # uniform in this box about the goal: m, m, rad

figure, axes = plt.subplots()
for preset in ("paper", "tuned"):
    law, settings = PRESETS[preset].law, configure({"preset": preset}, PRESETS[preset].law)
    case = make_case(settings, duration=40.0, feedback="ekf", tolerance=(0.1, 0.1), law=law)
    outcomes = run_batch(case, ANYWHERE, SEED, first=0, count=RUNS, law=law)
    x, y = (outcomes[:, COLUMNS.index(name)] for name in ("x", "y"))
    error, settling = np.hypot(x, y), outcomes[:, COLUMNS.index("settling_time")]
    settled = np.isfinite(settling)
    share, median = settled.mean(), np.median(settling[settled]) if settled.any() else math.nan
    print(f"{preset:<6} {share:6.1%} within 0.1 m and 0.1 rad, after {median:.1f} s; error {np.median(error):.3f} m")
    axes.plot(np.sort(error), np.linspace(0.0, 1.0, RUNS), label=preset)
axes.set(xlabel="true distance from the goal after 40 s [m]", ylabel="share of the runs", xlim=(0.0, 0.6))
axes.legend()
figure.savefig("monte_carlo.png")
