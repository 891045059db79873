"""Goals as fast as asked for, as a process: ``python goal_flood.py RATE SECONDS X``; prints how many it sent."""

import sys
import time

import rclpy
from geometry_msgs.msg import PoseStamped
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions


def main():
    rate, seconds, x = map(float, sys.argv[1:])
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    publisher = Node("goal_flood").create_publisher(PoseStamped, "goal_pose", 10)
    message = PoseStamped()
    message.header.frame_id = "map"
    message.pose.orientation.w = 1.0
    while not publisher.get_subscription_count():
        time.sleep(0.01)
    print("ready", flush=True)
    begin, sent = time.monotonic(), 0
    while (passed := time.monotonic() - begin) < seconds:
        while sent < passed * rate:
            message.pose.position.x = x + sent % 10
            publisher.publish(message)
            sent += 1
        time.sleep(1e-3)
    print(f"sent {sent}", flush=True)


if __name__ == "__main__":
    main()
