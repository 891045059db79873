"""Read a bag without ROS and plot the estimated path and the ground truth.

    python examples/plot_bag.py BAG [PICTURE]

BAG is, for example, the bag that goal_from_python.py records. The default of PICTURE is plot_bag.png.
"""

import sys
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from diffbot_core.errors import DiffbotError
from diffbot_tools.view.bag_source import read_bag

if len(sys.argv) not in (2, 3):
    sys.exit(__doc__)
try:
    run = read_bag(Path(sys.argv[1]))  # to read single messages, use diffbot.Bag
except DiffbotError as error:
    sys.exit(str(error))
curves = run.robots[0].curves
if "error" not in curves:
    sys.exit(f"{sys.argv[1]} must contain both estimated and true poses")

truth = curves["truth"]
error = np.hypot(curves["error"]["x"], curves["error"]["y"])
print(f"{run.messages} messages, {len(truth['t'])} true poses, {truth['t'][-1]:.1f} s")
print(f"error of the estimate: median {np.median(error):.3f} m, largest {np.max(error):.3f} m")

figure, (path, errors) = plt.subplots(1, 2, figsize=(10.0, 4.0), layout="constrained")
if "fixes" in curves:
    path.plot(curves["fixes"]["x"], curves["fixes"]["y"], ".", color="grey", markersize=2, label="fixes")
for name in ("truth", "estimate"):
    path.plot(curves[name]["x"], curves[name]["y"], label=name)
path.set(xlabel="x [m]", ylabel="y [m]")
path.set_aspect("equal", adjustable="datalim")
path.legend()
errors.plot(curves["error"]["t"], error)
errors.set(xlabel="t [s]", ylabel="error of the estimate [m]")
figure.savefig(sys.argv[2] if len(sys.argv) == 3 else "plot_bag.png")
