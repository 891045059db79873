"""The simulated robot as a Gymnasium environment (extra ``gym``); importing this package registers it.

``gymnasium.make("diffbot_lab.gym:DiffbotGoal-v0")`` imports the package by itself.
"""

from gymnasium.envs.registration import register

GOAL = "DiffbotGoal-v0"
"""Drive to a goal pose, see :mod:`environment`."""
MAX_STEPS = 300
"""Steps of an episode, 30 s with the default sampling time; then it is truncated."""

register(
    GOAL,
    "diffbot_lab.gym.environment:DiffbotGoalEnv",
    max_episode_steps=MAX_STEPS,
    vector_entry_point="diffbot_lab.gym.vector:DiffbotGoalVectorEnv",
)
