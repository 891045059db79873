"""The simulated robot as a Gymnasium environment (extra ``gym``). Importing this package registers the environment.

``gymnasium.make("diffbot_lab.gym:DiffbotGoal-v0")`` imports this package.
"""

from gymnasium.envs.registration import register

GOAL = "DiffbotGoal-v0"
"""Name of the environment."""
MAX_STEPS = 300
"""number of steps after which an episode is truncated: 30 s with the default sampling time"""

register(
    GOAL,
    "diffbot_lab.gym.environment:DiffbotGoalEnv",
    max_episode_steps=MAX_STEPS,
    vector_entry_point="diffbot_lab.gym.vector:DiffbotGoalVectorEnv",
)
