"""Published laws for driving to a pose, with which the benchmark compares the law of this project.

They are registered under ``diffbot.controllers``, so that nodes can run them, too. All of them get the robot's data
sheet, and share what is part of a law's use but not of its publication (:mod:`common`): the prediction over latency and
lag, the limits, dead bands, braking within the limits, and standing still at the goal.
"""
