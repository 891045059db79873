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
known = run.estimate[:, 0]
estimate = [np.interp(time, known, column, left=np.nan, right=np.nan) for column in run.estimate[:, 1:3].T]
error = np.hypot(estimate[0] - truth[0], estimate[1] - truth[1])
print(f"{run.messages} messages, {len(time)} true poses, {time[-1]:.1f} s")
print(f"error of the estimate: median {np.nanmedian(error):.3f} m, largest {np.nanmax(error):.3f} m")

figure, (path, errors) = plt.subplots(1, 2, figsize=(10.0, 4.0), layout="constrained")
path.plot(*run.fixes[:, 1:3].T, ".", color="grey", markersize=2, label="fixes")
path.plot(*truth[:2], label="truth")
path.plot(*run.estimate[:, 1:3].T, label="estimate")
path.set(xlabel="x [m]", ylabel="y [m]")
path.set_aspect("equal", adjustable="datalim")
path.legend()
errors.plot(time, error)
errors.set(xlabel="t [s]", ylabel="error of the estimate [m]")
figure.savefig(sys.argv[2] if len(sys.argv) == 3 else "plot_bag.png")
