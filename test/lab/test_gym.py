"""The Gymnasium environment against gymnasium's checker, the closed loop, and rewards calculated by hand."""

import math

import gymnasium
import numpy as np
import pytest
from driven import seen
from gymnasium.error import ResetNeeded
from gymnasium.utils.env_checker import check_env

from diffbot_control.law import PRESETS
from diffbot_core.data_sheet import DataSheet
from diffbot_core.errors import InvalidValueError
from diffbot_core.geometry import Pose
from diffbot_lab.cases import Configuration, make_case
from diffbot_lab.gym.environment import DiffbotGoalEnv
from diffbot_sim import batch
from diffbot_sim.batch import Starts, run_histories
from diffbot_sim.config import PlantConfig, SensorConfig, WorldConfig

NAME = "diffbot_lab.gym:DiffbotGoal-v0"
GOAL = Pose(0.0, 0.0, 0.0)
QUIET = WorldConfig(PlantConfig(drive_noise=0.0, encoder_noise=0.0))
STILL = np.zeros(2, np.float32)


def drive(preset, steps, feedback, sheet):
    """Drive by a law through the environment; return environment, true poses, feedback and last result of step."""
    env = DiffbotGoalEnv(feedback=feedback, data_sheet=sheet)
    _, info = env.reset(seed=3)
    law, config = PRESETS[preset]
    memory, dt, infos, answer = law.new_memory(config), 0.0, [info], None
    for _ in range(steps):
        observation = seen(Pose(*infos[-1]["feedback"].tolist()), dt=dt)
        memory, command, _ = law.step(memory, observation, GOAL, config)
        answer = env.step(np.array([command.v / sheet.v_max, command.omega / sheet.omega_max]))
        infos.append(answer[-1])
        dt = 0.1
        if answer[2]:
            break
    return env, np.array([one["truth"] for one in infos]), np.array([one["feedback"] for one in infos]), answer


def test_gymnasiums_checker_accepts_the_environment():
    check_env(gymnasium.make(NAME).unwrapped)


@pytest.mark.parametrize("feedback", ["ekf", "raw", "truth"])
def test_a_law_drives_as_in_the_simulation(feedback, monkeypatch):
    # One run in plain Python takes less time than loading the compiled loop.
    monkeypatch.setattr(batch, "_kernel", lambda law, index, _: batch._make_fill(law, index))
    # The paper does not limit turn rate and wheel speeds.
    env, truth, poses, _ = drive("paper", 40, feedback, DataSheet(omega_max=100.0, wheel_max=math.inf))
    assert len(truth) == 41
    world, (law, config) = env.world, PRESETS["paper"]
    case = make_case(Configuration(world.plant, world.sensors, config), 4.0, law=law, feedback=feedback)
    recorded = run_histories(case, Starts(np.array([world.start])), world.seed, world.run, 1, law=law)[0]
    np.testing.assert_allclose(truth, recorded[:, :3], rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(poses, recorded[:, 3:6], rtol=0.0, atol=1e-9)


def test_an_episode_terminates_at_the_goal():
    _, truth, _, answer = drive("tuned", 300, "truth", DataSheet())
    _, reward, terminated, truncated, info = answer
    assert (terminated, truncated, info["is_success"]) == (True, False, True)
    assert math.hypot(*truth[-1, :2]) <= 0.1
    assert abs(truth[-1, 2]) <= 0.1
    assert reward > 9.0


def test_an_observation_contains_the_goal_in_the_robots_frame_and_the_speeds():
    env = DiffbotGoalEnv(world=QUIET, feedback="truth")
    observation, _ = env.reset(seed=1, options={"start": (0.0, -2.0, math.pi)})
    # The goal is 2 m away to the right of the robot, and in the direction of y in the goal's frame.
    assert observation == pytest.approx([2.0, 0.0, -1.0, 0.0, 1.0, 0.0, 0.0], abs=1e-6)
    observation, *_ = env.step(np.array([0.5, -0.25], np.float32))
    assert observation[5:] == pytest.approx([0.65, -0.65], abs=1e-6)


def test_rewards_are_progress_minus_time_and_a_penalty_for_leaving_the_arena():
    env = DiffbotGoalEnv(world=QUIET, feedback="truth", start_range=1.0)
    env.reset(seed=1, options={"start": (-1.0, 0.0, 0.0)})
    rewards = [env.step(np.array(action, np.float32))[1] for action in ((1.0, 0.0), (0.0, 0.0), (0.0, 1.0))]
    assert rewards == pytest.approx([0.13 - 0.01, -0.01, -0.2 * 0.26 - 0.01])
    env.reset(seed=1, options={"start": (2.9, 0.0, 0.0)})
    _, reward, terminated, _, info = env.step(np.array([1.0, 0.0], np.float32))
    assert (terminated, info["is_success"]) == (True, False)
    assert reward == pytest.approx(-0.13 - 0.01 - 10.0)


@pytest.mark.study
def test_wrong_values_are_refused():
    for given, text in (
        ({"feedback": "gps"}, "feedback = 'gps': must be one of"),
        ({"data_sheet": DataSheet(v_max=math.inf)}, "v_max = inf: must be"),
        ({"world": WorldConfig(sensors=SensorConfig(fix_delay=1.25))}, "fix_delay = 1.25: must be <= 1 s"),
    ):
        with pytest.raises(InvalidValueError, match=text):
            DiffbotGoalEnv(**given)
    env = DiffbotGoalEnv(world=WorldConfig(sensors=SensorConfig(fix_rate=0.0)))
    envs = gymnasium.make_vec(NAME, 2, world=env.config)
    with pytest.raises(ResetNeeded):
        envs.step(np.zeros((2, 2), np.float32))
    for one in (env, envs):
        with pytest.raises(InvalidValueError, match="feedback = 'ekf'"):
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


def test_a_picture_shows_the_robot_at_its_pose():
    env = gymnasium.make(NAME, render_mode="rgb_array", feedback="truth", start_range=4.0)
    for start in ((-3.0, 2.0, 0.0), (3.0, -2.0, 0.0)):
        env.reset(seed=1, options={"start": start})
        picture = env.render().astype(int)
        assert picture.shape == (400, 400, 3)
        blue = np.argwhere((picture[:, :, 2] > 200) & (picture[:, :, :2].max(axis=2) < 60))
        row, column = blue.mean(axis=0)
        # The picture is 9.6 m wide. The arrow is half a metre long and points along x.
        assert column == pytest.approx(200 + (start[0] + 0.3) / 9.6 * 400, abs=8)
        assert row == pytest.approx(200 - start[1] / 9.6 * 400, abs=5)


BUSY = WorldConfig(
    PlantConfig(command_delay=0.13, drive_time_constant=0.1),
    SensorConfig(fix_rate=5.0, fix_delay=0.25, fix_dropout=0.3),
)


def drive_both(steps, **given):
    """Compare the vector environment with single ones; return the numbers of terminated and truncated episodes."""
    envs = gymnasium.make_vec(NAME, 3, **given), gymnasium.make_vec(NAME, 3, vectorization_mode="sync", **given)
    assert envs[0].observation_space == envs[1].observation_space
    ours, theirs = (one.reset(seed=5) for one in envs)
    generator, ends = np.random.default_rng(1), np.zeros(2)
    for _ in range(steps):
        for mine, other in zip(ours[:-1], theirs[:-1], strict=True):
            np.testing.assert_allclose(mine, other, rtol=0.0, atol=1e-6)
        for name, values in theirs[-1].items():
            np.testing.assert_allclose(ours[-1][name], values, rtol=0.0, atol=1e-9, err_msg=name)
        actions = generator.uniform(-0.2, 1.0, (3, 2)).astype(np.float32)
        ours, theirs = (one.step(actions) for one in envs)
        ends += ours[2].sum(), ours[3].sum()
    return ends


# Each feedback is compiled separately, so the feedback raw is left out.
@pytest.mark.parametrize(("feedback", "world"), [("ekf", WorldConfig()), ("ekf", BUSY), ("truth", BUSY)])
def test_the_vector_environment_equals_single_environments(feedback, world):
    # In a small arena and short episodes, some robots leave the arena and other episodes are truncated.
    given = {"feedback": feedback, "world": world, "start_range": 0.3, "max_episode_steps": 15}
    assert (drive_both(60, **given) > 0).all()


def test_long_episodes_of_the_vector_environment_have_the_same_noise():
    # Noise is drawn in blocks of 64 steps, and the robots wait for their first pose for different times.
    world = BUSY._replace(sensors=BUSY.sensors._replace(fix_dropout=0.8))
    assert (drive_both(200, world=world, start_range=20.0) == 0).all()
