"""Drive an ideal robot to (0, 0, 0) with the law alone, without ROS, noise or filter, and plot its paths.

    python examples/law_alone.py

Writes law_alone.png.
"""

import matplotlib.pyplot as plt

from diffbot_control.law import CONTACT_UNKNOWN, Observation, SwitchingConfig, new_memory, step
from diffbot_core.geometry import Pose
from diffbot_core.uncertainty import CERTAIN, Estimate
from diffbot_sim.plant import integrate

GOAL, DT = Pose(0.0, 0.0, 0.0), 0.1  # m, m, rad in map; s
STARTS = Pose(-2.0, -5.5, 0.52), Pose(3.0, 3.0, 0.0), Pose(0.5, -2.0, 3.1)

figure, axes = plt.subplots()
for start in STARTS:
    memory, path = new_memory(), [start]
    while not memory.reached and len(path) < 500:
        observation = Observation(Estimate(path[-1], CERTAIN), DT, DT, CONTACT_UNKNOWN)
        memory, command, report = step(memory, observation, GOAL, SwitchingConfig())
        path.append(integrate(path[-1], command, DT, exact_arc=True))
    x, y, theta = path[-1]
    print(f"from {start}: after {DT * len(path):.1f} s at {x:.3f} m, {y:.3f} m, {theta:.3f} rad")
    axes.plot([pose.x for pose in path], [pose.y for pose in path], label=f"from ({start.x}, {start.y})")
axes.set(xlabel="x [m]", ylabel="y [m]", aspect="equal")
axes.legend()
figure.savefig("law_alone.png")
