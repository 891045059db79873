"""``DiffbotGoal-v0`` many at a time, on the compiled loop (extra ``batch``), in one thread.

As always with gymnasium::

    envs = gymnasium.make_vec("diffbot_lab.gym:DiffbotGoal-v0", num_envs=1024)
    observations, infos = envs.reset(seed=1)
    observations, rewards, terminations, truncations, infos = envs.step(envs.action_space.sample())

Actions, observations, rewards, ends and random numbers are those of :mod:`environment` under gymnasium's SyncVectorEnv,
to rounding: environment i is seeded with ``seed + i``, and one that has ended is reset by the next step, which ignores
its action (AutoresetMode.NEXT_STEP). The first use compiles, which takes a minute or two; later ones load the result.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple, cast

import numpy as np
from gymnasium.spaces import Box
from gymnasium.utils.seeding import np_random
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numba.typed import List
from numpy.typing import NDArray

from diffbot_control.filter.localization_config import LocalizationConfig
from diffbot_control.filter.options import options_of
from diffbot_core.code_hash import hash_of_folders
from diffbot_core.data_sheet import DataSheet
from diffbot_core.geometry import Pose
from diffbot_core.kinematics import Twist, body_twist
from diffbot_lab.gym import MAX_STEPS, task
from diffbot_lab.gym.environment import (
    MAX_WAIT,
    DiffbotGoalEnv,
    Floats,
    checked_actions,
    checked_start,
    drawn_episode,
    no_pose,
)
from diffbot_lab.gym.task import Task, observed, requested, score
from diffbot_sim.compiled.batch import FEEDBACK_CODES, check_robot
from diffbot_sim.compiled.closed_loop import TRUTH
from diffbot_sim.compiled.gated_filter import new_track
from diffbot_sim.compiled.jit import LIBRARIES, compile_kernel, make_callable, one_compiler
from diffbot_sim.compiled.late_fusion import example_for, late_steps, new_buffers
from diffbot_sim.compiled.sensing import Robot
from diffbot_sim.compiled.stepping import Fleet, advance, new_body, put
from diffbot_sim.feedback import EKF
from diffbot_sim.model.actuators import command_rows
from diffbot_sim.model.simulator import WorldConfig

Array = NDArray[np.float64]
_VERSION = hash_of_folders([Path(__file__).parent], LIBRARIES)

for _function in (task.requested, task.observed, task.score, task.distance):
    make_callable(_function)


class Common(NamedTuple):
    """What the environments have in common, and the robots themselves."""

    kind: int
    """one of FEEDBACK_CODES' values"""
    robot: Robot
    run: int
    task: Task
    fleet: Fleet


class Episodes(NamedTuple):
    """How episodes begin, and which do now."""

    seeds: Any
    """(n,) of the noise"""
    starts: Any
    """(n, 3)"""
    fresh: Any
    """(n,) True to begin one"""


class Results(NamedTuple):
    """Arrays that a step fills."""

    observations: Any
    """(n, 7)"""
    scores: Any
    """(n, 3) as :class:`task.Score`"""
    truth: Any
    """(n, 3) true pose"""
    feedback: Any
    """(n, 3)"""


def _keep(common: Common) -> Any:
    """Return a list of ``common`` alone, with the fleet's lists filled.

    The type of a list is known; that of all that is in it would take a millisecond to find at each call.
    """
    fleet, bodies, tracks = common.fleet, List(), List()
    for _ in range(len(fleet.filter)):
        bodies.append(new_body(Pose(0.0, 0.0, 0.0)))
    for _ in range(fleet.steps.size + 1):  # one more, which gives an empty list its type
        tracks.append(new_track())
    full = Fleet(bodies, tracks, fleet.filter, fleet.steps, fleet.stamps, fleet.seen, fleet.commands)
    kept = List()
    kept.append(Common(common.kind, common.robot, common.run, common.task, full))
    return kept


def _step(kept: Any, episodes: Episodes, actions: Any, results: Results) -> bool:
    """Step every environment, or let its episode begin; False if a robot has waited in vain for its first pose."""
    kind, robot, run, task, fleet = kept[0]
    seeds, starts, fresh = episodes
    for index in range(len(actions)):
        seed, scores = seeds[index], results.scores[index]
        if fresh[index]:
            body = put(fleet, index, kind, robot, seed, run, Pose(starts[index, 0], starts[index, 1], starts[index, 2]))
            for _ in range(MAX_WAIT):
                if body.feedback.known:
                    break
                body = advance(fleet, index, kind, robot, seed, run, Twist(0.0, 0.0))
            if not body.feedback.known:
                return False
            scores[0] = scores[1] = scores[2] = 0.0
        else:
            before = fleet.bodies[index].state.pose
            command = requested(actions[index, 0], actions[index, 1], task.data_sheet)
            body = advance(fleet, index, kind, robot, seed, run, command)
            scores[0], scores[1], scores[2] = score(before, body.state.pose, command, task)
        seen = observed(body.feedback.pose, body_twist(body.state.encoder, robot.plant.wheels))
        for column in range(len(seen)):
            results.observations[index, column] = seen[column]
        for row, pose in ((results.truth[index], body.state.pose), (results.feedback[index], body.feedback.pose)):
            row[0], row[1], row[2] = pose
    return True


_compiled_keep, _compiled_step = compile_kernel(_keep, _VERSION), compile_kernel(_step, _VERSION)


class DiffbotGoalVectorEnv(VectorEnv[Floats, Floats, NDArray[Any]]):
    """The environments; the module describes them."""

    metadata = {"render_modes": [], "autoreset_mode": AutoresetMode.NEXT_STEP}  # noqa: RUF012 - as gymnasium has it

    def __init__(
        self,
        num_envs: int = 1,
        world: WorldConfig | None = None,
        feedback: str = EKF,
        data_sheet: DataSheet | None = None,
        start_range: float = 5.0,
        max_episode_steps: int = MAX_STEPS,
    ) -> None:
        """Describe the task of each as :class:`DiffbotGoalEnv` does, and compile.

        Raises:
            InvalidValueError: as there; for measurements that arrive later than the filter's history reaches.
        """
        one = DiffbotGoalEnv(world, feedback, data_sheet, start_range)
        self.num_envs, self._one, self._max_steps = num_envs, one, max_episode_steps
        self.single_action_space, self.single_observation_space = one.action_space, one.observation_space
        self.action_space = batch_space(one.action_space, num_envs)
        self.observation_space = batch_space(one.observation_space, num_envs)
        localization = LocalizationConfig()
        plant, sensors, points = one.config.plant, one.config.sensors, one.config.landmarks.points()
        landmarks = np.array([*points.values()], dtype=np.float64).reshape(-1, 2)
        options = options_of(localization.filter, landmarks=bool(points))
        robot, late = Robot(plant, sensors, options, landmarks), 0
        if FEEDBACK_CODES[feedback] != TRUTH:
            check_robot(robot, localization.history_length)
            late = late_steps(sensors, plant.sampling_time)
        first = new_buffers(late, len(landmarks), example_for(landmarks, options))
        arrays = [
            np.repeat(array[None], num_envs, axis=0)
            for array in (first.filter[0], first.steps, first.stamps[0], first.seen)
        ]
        arrays.append(np.zeros((num_envs, command_rows(plant.actuators.command_delay, plant.sampling_time), 2)))
        seeds, starts = np.zeros(num_envs, dtype=np.int64), np.zeros((num_envs, 3))
        self._episodes = Episodes(seeds, starts, np.ones(num_envs, dtype=bool))
        self._elapsed: NDArray[np.int64] = np.zeros(num_envs, dtype=np.int64)
        self._generators: list[np.random.Generator] = []
        with one_compiler(_VERSION):
            fleet = Fleet(None, None, *arrays)
            self._kept = _compiled_keep(Common(FEEDBACK_CODES[feedback], robot, one.config.run, one.task, fleet))
            self._run(np.zeros((0, 2)))

    def reset(
        self, *, seed: int | list[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Floats, dict[str, Any]]:
        """Begin an episode in each; ``seed + i``, or entry i of a list, is the seed of environment i.

        Raises:
            InvalidValueError: as :meth:`DiffbotGoalEnv.reset`.
        """
        seeds = seed if isinstance(seed, list) else [None if seed is None else seed + i for i in range(self.num_envs)]
        if not self._generators:
            self._generators = [np_random(one)[0] for one in seeds]
        for index, one in enumerate(seeds):
            if one is not None:
                self._generators[index] = np_random(one)[0]
        self._episodes.fresh[:] = True
        self._draw()
        if options and "start" in options:
            self._episodes.starts[:] = checked_start(options["start"])
        results = self._run(np.zeros((self.num_envs, 2)))
        self._elapsed[:], self._episodes.fresh[:] = 0, False
        return results.observations, self._infos(results)

    def step(self, actions: Floats) -> tuple[Floats, NDArray[Any], NDArray[Any], NDArray[Any], dict[str, Any]]:
        """Drive each for one sampling time, or reset it if it has ended.

        Raises:
            InvalidValueError: for actions that are not (num_envs, 2) finite numbers; others are clipped to the space.
        """
        shares, fresh = checked_actions(actions, (self.num_envs, 2)), self._episodes.fresh
        self._draw()
        results = self._run(shares)
        self._elapsed += 1
        self._elapsed[fresh] = 0
        terminated, truncated = results.scores[:, 1:].any(axis=1), self._elapsed >= self._max_steps
        fresh[:] = terminated | truncated
        return results.observations, results.scores[:, 0].copy(), terminated, truncated, self._infos(results)

    def _draw(self) -> None:
        """Draw start and noise of the episodes that begin."""
        seeds, starts, fresh = self._episodes
        for index in np.flatnonzero(fresh):
            starts[index], seeds[index] = drawn_episode(self._generators[index], self._one.start_range)

    def _run(self, actions: Array) -> Results:
        """Call the kernel for the first environments, as many as there are ``actions``."""
        n, space = len(actions), cast(Box, self._one.observation_space)
        results = Results(np.empty((n, 7), np.float32), np.empty((n, 3)), np.empty((n, 3)), np.empty((n, 3)))
        if not _compiled_step(self._kept, self._episodes, actions, results):
            raise no_pose(self._one.feedback)
        np.clip(results.observations, space.low, space.high, out=results.observations)
        return results

    def _infos(self, results: Results) -> dict[str, Any]:
        infos = {"truth": results.truth, "feedback": results.feedback, "is_success": results.scores[:, 1] > 0.0}
        return infos | {f"_{name}": np.ones(self.num_envs, dtype=bool) for name in infos}
