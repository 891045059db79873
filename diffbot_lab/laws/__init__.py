"""Published laws for driving to a pose, with which the benchmark compares the law of this project.

The laws are entry points in the group ``diffbot.controllers``, so nodes can run them as well. Each law receives the
robot's data sheet. The module :mod:`common` adds what a robot needs and the publications leave out: prediction over
dead time and lag, limits, dead bands, braking within the limits, and stopping at the goal.
"""
