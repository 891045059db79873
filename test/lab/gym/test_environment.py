"""The Gymnasium environment: gymnasium's own checker, the closed loop of the simulation, and the reward by hand."""

import math

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from diffbot_control.law import PRESETS, ControllerMemory, step
from diffbot_core.data_sheet import DataSheet
from diffbot_core.errors import InvalidValueError
from diffbot_core.geometry import Pose
from diffbot_core.uncertainty import CERTAIN, Estimate
from diffbot_lab.gym.environment import DiffbotGoalEnv
from diffbot_sim.model.actuators import ActuatorConfig
from diffbot_sim.model.plant import PlantConfig
from diffbot_sim.model.sensors import SensorConfig
from diffbot_sim.model.simulator import WorldConfig
from diffbot_sim.reference_loop import simulate

NAME = "diffbot_lab.gym:DiffbotGoal-v0"
GOAL = Pose(0.0, 0.0, 0.0)
QUIET = WorldConfig(PlantConfig(drive_noise=0.0, encoder_noise=0.0))
STILL = np.zeros(2, np.float32)


def drive(controller, steps, feedback, sheet):
    """Let the law drive by what the environment tells it; return it, true poses, feedback and the last answer."""
    env = DiffbotGoalEnv(feedback=feedback, data_sheet=sheet)
    _, info = env.reset(seed=3)
    memory, dt, told, answer = ControllerMemory(), 0.0, [info], None
    for _ in range(steps):
        estimate = Estimate(Pose(*told[-1]["feedback"].tolist()), CERTAIN)
        memory, command, _ = step(memory, estimate, GOAL, dt, controller)
        answer = env.step(np.array([command.v / sheet.v_max, command.omega / sheet.omega_max]))
        told.append(answer[-1])
        dt = 0.1
        if answer[2]:
            break
    return env, np.array([one["truth"] for one in told]), np.array([one["feedback"] for one in told]), answer


def test_gymnasium_finds_no_fault():
    """A warning of the checker is an error, too."""
    check_env(gymnasium.make(NAME).unwrapped)


@pytest.mark.parametrize("feedback", ["ekf", "raw", "truth"])
def test_a_law_drives_as_in_the_closed_loop(feedback):
    # The paper bounds neither the turn rate nor the wheels.
    env, truth, poses, _ = drive(PRESETS["paper"], 40, feedback, DataSheet(omega_max=100.0, wheel_max=math.inf))
    assert len(truth) == 41
    recorded = simulate(env.world.config, PRESETS["paper"], GOAL, 40, feedback)
    np.testing.assert_allclose(truth, recorded.truth, rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(poses, recorded.feedback, rtol=0.0, atol=1e-9)


def test_at_the_goal_an_episode_is_terminated():
    _, truth, _, answer = drive(PRESETS["tuned"], 300, "truth", DataSheet())
    _, reward, terminated, truncated, info = answer
    assert (terminated, truncated, info["is_success"]) == (True, False, True)
    assert math.hypot(*truth[-1, :2]) <= 0.1
    assert abs(truth[-1, 2]) <= 0.1
    assert reward > 9.0


def test_observation_is_the_goal_seen_from_the_robot():
    env = DiffbotGoalEnv(world=QUIET, feedback="truth")
    observation, _ = env.reset(seed=1, options={"start": (0.0, -2.0, math.pi)})
    # The goal is 2 m away, to the robot's right; in the goal's frame it lies in the direction of y.
    assert observation == pytest.approx([2.0, 0.0, -1.0, 0.0, 1.0, 0.0, 0.0], abs=1e-6)
    observation, *_ = env.step(np.array([0.5, -0.25], np.float32))
    assert observation[5:] == pytest.approx([0.65, -0.65], abs=1e-6)


def test_rewards_are_the_way_to_the_goal_less_the_time_and_a_loss_for_leaving_the_arena():
    env = DiffbotGoalEnv(world=QUIET, feedback="truth", start_range=1.0)
    env.reset(seed=1, options={"start": (-1.0, 0.0, 0.0)})
    rewards = [env.step(np.array(action, np.float32))[1] for action in ((1.0, 0.0), (0.0, 0.0), (0.0, 1.0))]
    assert rewards == pytest.approx([0.13 - 0.01, -0.01, -0.2 * 0.26 - 0.01])
    env.reset(seed=1, options={"start": (2.9, 0.0, 0.0)})
    _, reward, terminated, _, info = env.step(np.array([1.0, 0.0], np.float32))
    assert (terminated, info["is_success"]) == (True, False)
    assert reward == pytest.approx(-0.13 - 0.01 - 10.0)


def test_bad_values_are_refused():
    for given, text in (
        ({"feedback": "gps"}, "feedback = 'gps': must be one of"),
        ({"data_sheet": DataSheet(v_max=math.inf)}, "v_max = inf: must be"),
    ):
        with pytest.raises(InvalidValueError, match=text):
            DiffbotGoalEnv(**given)
    env = DiffbotGoalEnv(world=WorldConfig(sensors=SensorConfig(fix_rate=0.0)), feedback="raw")
    envs = gymnasium.make_vec(NAME, 2, world=env.config, feedback="raw")
    for one in (env, envs):
        with pytest.raises(InvalidValueError, match="feedback = 'raw'"):
            one.reset(seed=1)
    with pytest.raises(InvalidValueError, match="action = "):
        envs.step(STILL)
    env = DiffbotGoalEnv(feedback="truth")
    for start in ((1.0, 2.0), (math.nan, 0.0, 0.0)):
        with pytest.raises(InvalidValueError, match="start = "):
            env.reset(options={"start": start})
    env.reset(seed=1)
    for action in (np.array([math.nan, 0.0]), np.zeros(3)):
        with pytest.raises(InvalidValueError, match="action = "):
            env.step(action)


def test_a_picture_shows_the_robot_where_it_is():
    env = gymnasium.make("diffbot_lab.gym:DiffbotGoal-v0", render_mode="rgb_array", feedback="truth", start_range=4.0)
    for start in ((-3.0, 2.0, 0.0), (3.0, -2.0, 0.0)):
        env.reset(seed=1, options={"start": start})
        picture = env.render().astype(int)
        assert picture.shape == (400, 400, 3)
        blue = np.argwhere((picture[:, :, 2] > 200) & (picture[:, :, :2].max(axis=2) < 60))
        row, column = blue.mean(axis=0)
        # 9.6 m wide, y upwards; the arrow is half a metre long and points along x.
        assert column == pytest.approx(200 + (start[0] + 0.3) / 9.6 * 400, abs=8)
        assert row == pytest.approx(200 - start[1] / 9.6 * 400, abs=5)


BUSY = WorldConfig(
    PlantConfig(actuators=ActuatorConfig(command_delay=0.13, drive_time_constant=0.1)),
    SensorConfig(fix_rate=5.0, fix_delay=0.25, fix_delay_jitter=0.1, fix_dropout=0.3),
)


@pytest.mark.parametrize("world", [WorldConfig(), BUSY])
@pytest.mark.parametrize("feedback", ["ekf", "raw", "truth"])
def test_many_at_a_time_are_single_ones_with_the_same_noise_and_resets(feedback, world):
    # The arena is small, so that some leave it, and an episode short, so that others are truncated.
    given = {"num_envs": 3, "feedback": feedback, "world": world, "start_range": 0.3, "max_episode_steps": 15}
    envs = gymnasium.make_vec(NAME, **given), gymnasium.make_vec(NAME, vectorization_mode="sync", **given)
    assert envs[0].observation_space == envs[1].observation_space
    ours, theirs = (one.reset(seed=5) for one in envs)
    generator, ends = np.random.default_rng(1), np.zeros(2)
    for _ in range(60):
        for mine, other in zip(ours[:-1], theirs[:-1], strict=True):
            np.testing.assert_allclose(mine, other, rtol=0.0, atol=1e-6)
        for name, values in theirs[-1].items():
            np.testing.assert_allclose(ours[-1][name], values, rtol=0.0, atol=1e-9, err_msg=name)
        actions = generator.uniform(-0.2, 1.0, (3, 2)).astype(np.float32)
        ours, theirs = (one.step(actions) for one in envs)
        ends += ours[2].sum(), ours[3].sum()
    assert (ends > 0).all()
