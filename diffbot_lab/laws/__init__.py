"""Published laws for driving to a pose, with which the benchmark compares the law of this project.

The laws are registered under ``diffbot.controllers``, so nodes can run them as well. Each law receives the robot's data
sheet. The module :mod:`common` contains the parts that a robot needs and the publications leave out: prediction over
latency and lag, limits, dead bands, braking within the limits, and standing still at the goal.
"""
