"""A small dataset in the format of MR.CLAM, of a robot on a circle, and its import by examples/import_mrclam.py."""

import math
import runpy
import sys
from pathlib import Path
from unittest import mock

EXAMPLE = Path(__file__).parents[2] / "examples" / "import_mrclam.py"
BARCODES = {1: 5, 2: 14, 3: 41, 4: 32, 5: 23, 6: 63, 7: 81, 8: 7}
LANDMARKS = {6: (3.0, 0.0), 7: (0.0, 4.0), 8: (-2.0, -3.0)}
RADIUS, OMEGA, T0 = 1.5, 0.2, 1_248_446_190.0


def truth_at(time):
    """Return the pose on a counter-clockwise circle around the origin."""
    angle = OMEGA * time
    heading = math.remainder(angle + 0.5 * math.pi, 2.0 * math.pi)
    return RADIUS * math.cos(angle), RADIUS * math.sin(angle), heading


def measured(time, subject):
    """Return range and bearing of a landmark without errors."""
    x, y, theta = truth_at(time)
    dx, dy = LANDMARKS[subject][0] - x, LANDMARKS[subject][1] - y
    return math.hypot(dx, dy), math.remainder(math.atan2(dy, dx) - theta, 2.0 * math.pi)


def write_mrclam(folder, robot=1, duration=20.0):
    """Write a dataset of a camera that covers 1.2 rad to either side of the heading; return the folder."""
    folder.mkdir(exist_ok=True)
    steps = round(duration / 0.05)
    odometry = [f"{T0 + 0.05 * i:.3f} \t {RADIUS * OMEGA:.3f} \t {OMEGA:.3f}" for i in range(steps)]
    truth = [
        "{:.3f} \t {:.8f} \t {:.8f} \t {:.8f}".format(T0 - 1.0 + 0.02 * i, *truth_at(0.02 * i - 1.0))
        for i in range(round((duration + 2.0) / 0.02))
    ]
    rows = []
    for i in range(2, steps - 5, 5):
        time = 0.05 * i + 0.01
        for subject in LANDMARKS:
            distance, bearing = measured(time, subject)
            if abs(bearing) < 1.2:
                depth = distance * math.cos(bearing)
                rows.append(f"{T0 + time:.3f} \t {BARCODES[subject]} \t {depth:.8f} \t {bearing:.8f}")
    # A robot and a misread barcode.
    rows += [f"{T0 + 3.0:.3f} \t 14 \t 1.0 \t 0.1", f"{T0 + 3.0:.3f} \t 99 \t 1.0 \t 0.1"]
    files = {
        f"Robot{robot}_Odometry.dat": odometry,
        f"Robot{robot}_Groundtruth.dat": truth,
        f"Robot{robot}_Measurement.dat": rows,
        "Barcodes.dat": [f"  {subject} \t {code}" for subject, code in BARCODES.items()],
        "Landmark_Groundtruth.dat": [f" {s} \t {x} \t {y} \t 0.0001 \t 0.0005" for s, (x, y) in LANDMARKS.items()],
    }
    for name, lines in files.items():
        (folder / name).write_text("# Comment\n# Time [s]\n" + "\n".join(lines) + "\n")
    return folder


def import_mrclam(folder, robot, out):
    """Run the example in this process."""
    words = [str(EXAMPLE), str(folder), str(robot), str(out)]
    with mock.patch.object(sys, "argv", words):
        runpy.run_path(str(EXAMPLE), run_name="__main__")
    return out
