"""Read a bag without ROS and plot the estimate against the ground truth.

    python examples/plot_bag.py BAG [PICTURE]

BAG is for example the one of goal_from_python.py; the default of PICTURE is plot_bag.png.
"""

import sys
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from diffbot_core.errors import DiffbotError
from diffbot_tools.demo.run_record import read_run

if len(sys.argv) not in (2, 3):
    sys.exit(__doc__)
try:
    run = read_run(Path(sys.argv[1]))  # BagReader, in diffbot_bag.bag.reader, gives each message
except DiffbotError as error:
    sys.exit(str(error))
if not len(run.estimate):
    sys.exit(f"{sys.argv[1]}: no /pose in it")

time, *truth = run.truth.T
known, *estimate = run.estimate[:, :3].T
error = np.hypot(*(one - np.interp(known, time, true) for one, true in zip(estimate, truth, strict=False)))
print(f"{run.messages} messages, {len(time)} true poses, {time[-1]:.1f} s")
print(f"error of the estimate: median {np.median(error):.3f} m, largest {np.max(error):.3f} m")

figure, (path, errors) = plt.subplots(1, 2, figsize=(10.0, 4.0), layout="constrained")
path.plot(*run.fixes[:, 1:3].T, ".", color="grey", markersize=2, label="fixes")
path.plot(*truth[:2], label="truth")
path.plot(*estimate, label="estimate")
path.set(xlabel="x [m]", ylabel="y [m]")
path.set_aspect("equal", adjustable="datalim")
path.legend()
errors.plot(known, error)
errors.set(xlabel="t [s]", ylabel="error of the estimate [m]")
figure.savefig(sys.argv[2] if len(sys.argv) == 3 else "plot_bag.png")
