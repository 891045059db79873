"""Laws of others for going to a pose, as laws of the common protocol: what this project's own is compared with.

They are registered under ``diffbot.controllers`` and run in nodes, too; nothing here needs more than ``math``. Each
gets the robot's data sheet. What is not part of a published law but of its use is the same for all (:mod:`common`): the
compensation of latency and lag, the limits, dead bands, braking within the limits, and holding still once the goal is
reached.
"""
