"""Drive to twenty goals with a fifth of odometry and fixes lost: ``python test/bench/lossy_odometry.py [count]``.

Needs test/support on PYTHONPATH and ROS_DOMAIN_ID of its own. Prints the errors at the ends; exit status 1 if a goal
was missed.
"""

import sys

from lossy_drives import drive, goals
from robot import distance, turned
from tqdm import tqdm


def main():
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 20
    with tqdm(total=count, unit="goal", disable=None) as bar:
        ends, running = drive(count, lambda _: bar.update())
    pairs = [(end, goal) for end, goal in zip(ends, goals(count), strict=True) if end is not None]
    lost = [f"{relay.lost} of {relay.lost + relay.passed}" for relay in (running.odometry, running.fixes)]
    print(f"{len(pairs)} of {count} goals reached; lost: {lost[0]} odometry messages, {lost[1]} fixes")
    errors = [max((measure(*one) for one in pairs), default=0.0) for measure in (distance, turned)]
    print(f"largest errors at the ends: {errors[0]:.3f} m, {errors[1]:.3f} rad")
    return 0 if len(pairs) == count else 1


if __name__ == "__main__":
    sys.exit(main())
