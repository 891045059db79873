"""A process that sends goals at a rate, with pauses: ``python goal_flood.py RATE SECONDS TIMES X``.

TIMES times, it sends goals for SECONDS and pauses for SECONDS. It prints ``flood BEGIN END SENT`` for each flood and
``pause BEGIN END`` for each pause, in ns since 1970.
"""

import sys
import time

import rclpy
from geometry_msgs.msg import PoseStamped
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

SETTLING = 0.5
"""[s] between a flood and its pause"""


def main():
    rate, seconds, times, x = map(float, sys.argv[1:])
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    publisher = Node("goal_flood").create_publisher(PoseStamped, "goal_pose", 10)
    message = PoseStamped()
    message.header.frame_id = "map"
    message.pose.orientation.w = 1.0
    while not publisher.get_subscription_count():
        time.sleep(0.01)
    for _ in range(int(times)):
        begin, wall, sent = time.monotonic(), time.time_ns(), 0
        while sent < seconds * rate:
            due = min(time.monotonic() - begin, seconds) * rate
            while sent < due:
                message.pose.position.x = x + sent % 10
                publisher.publish(message)
                sent += 1
            time.sleep(1e-3)
        print(f"flood {wall} {time.time_ns()} {sent}", flush=True)
        time.sleep(SETTLING)
        wall = time.time_ns()
        time.sleep(seconds)
        print(f"pause {wall} {time.time_ns()}", flush=True)


if __name__ == "__main__":
    main()
