"""For all allowed parameters, the messages of the simulated robot contain only finite numbers."""

import warnings

import numpy as np
from extremes import assert_finite, extreme_configs, log_between

from diffbot_control.ros.messages.fields import MAX_SPEED
from diffbot_core.kinematics import Twist, body_twist
from diffbot_core.schema import build
from diffbot_sim.config import WorldConfig
from diffbot_sim.world import World

PAIRS = 60
STEPS = 12
BASE = build(
    WorldConfig,
    {
        **{"landmark_ids": [1, 2], "landmark_x": [2.0, -3.0], "landmark_y": [1.0, 4.0]},
        **{"heading_rate": 10.0, "landmark_rate": 10.0},
    },
)


def drive(config, rng):
    """Yield the numbers of all messages of each step, for commands up to the largest allowed speed."""
    world = World(config)
    for _ in range(STEPS):
        arrivals = world.sense()
        yield world.state, world.odometry()[1:], world.odometry_P, body_twist(world.state.encoder, config.plant.wheels)
        yield [one[1:] for one in (*arrivals.fixes, *arrivals.headings)]
        yield [one[1:4] for one in arrivals.landmarks]
        if rng.random() < 0.3:
            world.configure(config)
        world.advance(Twist(*(log_between(-MAX_SPEED, MAX_SPEED, rng) if rng.random() < 0.5 else 1.0 for _ in "vw")))


def test_messages_of_the_plant_are_finite():
    rng = np.random.default_rng(1)
    tried = 0
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # numpy's, of an overflow
        for values, config in extreme_configs(WorldConfig, 2, PAIRS, BASE):
            for sent in drive(config, rng):
                assert_finite(sent, values)
            tried += 1
    assert tried > PAIRS
