"""Many environments ``DiffbotGoal-v0`` in one thread, on the compiled simulation loop (extra ``batch``).

Use them as any vector environment::

    envs = gymnasium.make_vec("diffbot_lab.gym:DiffbotGoal-v0", num_envs=1024)
    observations, infos = envs.reset(seed=1)
    observations, rewards, terminations, truncations, infos = envs.step(envs.action_space.sample())

Except for rounding errors, the results are those of Gymnasium's SyncVectorEnv with environments of :mod:`environment`.
Environment i has the seed ``seed + i``. The step after the end of an episode resets the environment and ignores the
action (AutoresetMode.NEXT_STEP). The first use compiles the loop, which takes a minute or two. Later, the compiled loop
is loaded from a cache.
"""

from __future__ import annotations

from typing import Any, NamedTuple, cast

import numpy as np
from gymnasium.error import ResetNeeded
from gymnasium.spaces import Box
from gymnasium.utils.seeding import np_random
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numba.typed import List
from numpy.typing import NDArray

from diffbot_core.data_sheet import DataSheet
from diffbot_core.geometry import Pose
from diffbot_core.kinematics import body_twist
from diffbot_lab.gym import MAX_STEPS, environment
from diffbot_lab.gym.environment import DiffbotGoalEnv, Floats, Task, command_of, observation_of, score
from diffbot_sim.config import WorldConfig
from diffbot_sim.fusion import RunBuffers, SimulatedRobot, borrowed, new_buffers, reference_to
from diffbot_sim.jit import compile_kernel, source_hash
from diffbot_sim.noise import NoiseSource
from diffbot_sim.robot_step import EKF, FEEDBACKS, SENSES, advance, start
from diffbot_sim.sensors import purposes_of

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

_BLOCK = 64
"""number of steps for which the noise of a robot is drawn at once; seeding the generator takes longer than drawing"""


class Fleet(NamedTuple):
    """The robots of all environments."""

    robot: SimulatedRobot
    """configuration of every robot"""
    task: Task
    states: Any
    """list of the robots' :class:`RobotState`"""
    all_buffers: Any
    """list of references to the robots' :class:`RunBuffers`. The caller has to keep the buffers"""


class Episodes(NamedTuple):
    """Starts, noise and progress of all episodes."""

    starts: Any
    """(n, 3) x [m], y [m], theta [rad] in map"""
    noise: Any
    """(n, purposes, _BLOCK + 1, 4) numbers in [0, 1). Row 0 belongs to the last step that was a multiple of _BLOCK"""
    steps: Any
    """(n,) number of the current step of each robot"""


class Results(NamedTuple):
    """Arrays that a step fills."""

    observations: Any
    """(n, 7), not clipped"""
    scores: Any
    """(n, 3) results of :func:`environment.score`; not filled when an episode begins"""
    truth: Any
    """(n, 3) true pose in map"""
    feedback: Any
    """(n, 3) pose in map that a controller would receive"""
    known: Any
    """(n,) False until the first pose arrives"""


def _new_fleet(task: Task, buffers: RunBuffers) -> Any:
    """Return a list with one element, a fleet of one robot.

    As an argument of a compiled function, the list costs less than the fleet: Numba needs a millisecond in each call to
    determine the type of a fleet.
    """
    states, all_buffers, fleets = List(), List(), List()
    reference = reference_to(buffers)
    states.append(start(reference, Pose(0.0, 0.0, 0.0)))
    all_buffers.append(reference)
    fleets.append(Fleet(reference.robot, task, states, all_buffers))
    return fleets


def _add_robot(fleets: Any, buffers: RunBuffers) -> None:
    """Add a robot to the fleet."""
    fleet, reference = fleets[0], reference_to(buffers)
    fleet.states.append(start(reference, Pose(0.0, 0.0, 0.0)))
    fleet.all_buffers.append(reference)


def _make_step(feedback: int) -> Any:
    """Return the function that steps robots; ``feedback`` is an index of FEEDBACKS."""
    sense = SENSES[feedback]

    def step(fleets: Any, chosen: Any, begin: bool, episodes: Episodes, actions: Any, results: Results) -> None:
        """Move the chosen robots for one sampling time, or place them at their starts. Then measure and filter.

        Args:
            fleets: list of one fleet, see :func:`_new_fleet`.
            chosen: (k,) indices of the robots.
            begin: True to place the robots at their starts.
            episodes: of all robots, with the noise of this step and of the next step.
            actions: (n, 2) shares of v_max and omega_max, within -1 .. 1.
            results: of all robots. Only the rows of the chosen robots are filled.
        """
        robot, task, states, all_buffers = fleets[0]
        plant, sensors, starts = robot.plant, robot.sensors, episodes.starts
        for index in chosen:
            buffers, noise, row = all_buffers[index], borrowed(episodes.noise[index]), 0
            if begin:
                state = start(buffers, Pose(starts[index, 0], starts[index, 1], starts[index, 2]))
            else:
                state, scores = states[index], results.scores[index]
                before, row = state.plant.pose, state.plant.step % _BLOCK
                command = command_of(actions[index, 0], actions[index, 1], task.data_sheet)
                state = advance(state, buffers.commands, command, noise[:, row], plant)
                scores[0], scores[1], scores[2] = score(before, state.plant.pose, command, task)
                row += 1
            state = sense(state, buffers, noise[:, row], sensors, plant.sampling_time)
            states[index], episodes.steps[index], results.known[index] = state, state.plant.step, state.feedback.known
            twist = body_twist(state.plant.encoder, plant.wheels)
            for column, value in enumerate(observation_of(state.feedback.pose, twist)):
                results.observations[index, column] = value
            truth, feedback = results.truth[index], results.feedback[index]
            truth[0], truth[1], truth[2] = state.plant.pose
            feedback[0], feedback[1], feedback[2] = state.feedback.pose

    # Numba cannot tell cached functions of the same name and types apart, so each needs its own name.
    step.__qualname__ = f"step_{FEEDBACKS[feedback]}"
    return step


_STEPS = [_make_step(feedback) for feedback in range(len(FEEDBACKS))]
_VERSION = source_hash(_new_fleet, _add_robot, *_STEPS)
_compiled_new_fleet, _compiled_add_robot, *_compiled_steps = (
    compile_kernel(function, _VERSION) for function in (_new_fleet, _add_robot, *_STEPS)
)


class DiffbotGoalVectorEnv(VectorEnv[Floats, Floats, NDArray[Any]]):
    """Many environments, see :mod:`vector`."""

    metadata = {"render_modes": [], "autoreset_mode": AutoresetMode.NEXT_STEP}  # noqa: RUF012 - gymnasium declares it so

    def __init__(
        self,
        num_envs: int = 1,
        world: WorldConfig | None = None,
        feedback: str = EKF,
        data_sheet: DataSheet | None = None,
        start_range: float = 5.0,
        max_episode_steps: int = MAX_STEPS,
    ) -> None:
        """Create the environments and compile the loop. The arguments are those of :class:`DiffbotGoalEnv`.

        Raises:
            InvalidValueError: as :class:`DiffbotGoalEnv`.
        """
        one = DiffbotGoalEnv(world, feedback, data_sheet, start_range)
        self.num_envs, self._one, self._max_steps = num_envs, one, max_episode_steps
        self.single_action_space, self.single_observation_space = one.action_space, one.observation_space
        self.action_space = batch_space(one.action_space, num_envs)
        self.observation_space = batch_space(one.observation_space, num_envs)
        robot = one.robot
        self._purposes = purposes_of(robot.sensors, len(robot.landmarks), robot.plant.slip_noise)
        noise = np.empty((num_envs, max(self._purposes) + 1, _BLOCK + 1, 4))
        self._episodes = Episodes(np.zeros((num_envs, 3)), noise, np.zeros(num_envs, dtype=np.int64))
        self._source, self._seeds = NoiseSource(), np.zeros(num_envs, dtype=np.int64)
        self._fresh: NDArray[np.bool_] = np.ones(num_envs, dtype=bool)
        self._elapsed: NDArray[np.int64] = np.zeros(num_envs, dtype=np.int64)
        self._generators: list[np.random.Generator] = []
        self._all_buffers = [new_buffers(robot) for _ in range(num_envs)]
        self._step, nothing = _compiled_steps[FEEDBACKS.index(feedback)], np.zeros((0, 2))
        self._fleets = _compiled_new_fleet(one.task, self._all_buffers[0])
        for buffers in self._all_buffers[1:]:
            _compiled_add_robot(self._fleets, buffers)
        self._step(self._fleets, np.flatnonzero(nothing), False, self._episodes, nothing, self._new_results())

    def reset(
        self, *, seed: int | list[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Floats, dict[str, Any]]:
        """Begin an episode in each environment. The seed of environment i is ``seed + i``, or element i of a list.

        Raises:
            InvalidValueError: as :meth:`DiffbotGoalEnv.reset`.
        """
        seeds = seed if isinstance(seed, list) else [None if seed is None else seed + i for i in range(self.num_envs)]
        if not self._generators:
            self._generators = [np_random(one)[0] for one in seeds]
        for index, one in enumerate(seeds):
            if one is not None:
                self._generators[index] = np_random(one)[0]
        every, results = np.arange(self.num_envs), self._new_results()
        self._draw(every)
        if options and "start" in options:
            self._episodes.starts[:] = environment.checked_start(options["start"])
        self._begin(every, results)
        self._fresh[:] = False
        return self._observations(results), self._infos(results)

    def step(self, actions: Floats) -> tuple[Floats, NDArray[Any], NDArray[Any], NDArray[Any], dict[str, Any]]:
        """Move each robot for one sampling time, or reset its environment if the episode has ended.

        Actions are clipped to the action space.

        Raises:
            InvalidValueError: for actions that are not (num_envs, 2) finite numbers.
            ResetNeeded: before the first :meth:`reset`.
        """
        shares = environment.checked_actions(actions, (self.num_envs, 2))
        results, fresh = self._new_results(), self._fresh
        if not self._generators:
            raise ResetNeeded("call reset before the first step")
        self._run(np.flatnonzero(~fresh), shares, results)
        self._elapsed += 1
        if fresh.any():
            beginning = np.flatnonzero(fresh)
            self._draw(beginning)
            self._begin(beginning, results)
        terminated, truncated = results.scores[:, 1:].any(axis=1), self._elapsed >= self._max_steps
        self._fresh = terminated | truncated
        return self._observations(results), results.scores[:, 0].copy(), terminated, truncated, self._infos(results)

    def _draw(self, chosen: Indices) -> None:
        """Draw the starts and the noise seeds of new episodes."""
        for index in chosen:
            drawn = environment.draw_episode(self._generators[index], self._one.start_range)
            self._episodes.starts[index], self._seeds[index] = drawn

    def _begin(self, chosen: Indices, results: Results) -> None:
        """Place robots at their starts. They stand still until their first pose arrives."""
        self._episodes.steps[chosen], self._elapsed[chosen] = 0, 0
        self._draw_noise(chosen)
        still = np.zeros((self.num_envs, 2))
        self._step(self._fleets, chosen, True, self._episodes, still, results)
        waiting = chosen[~results.known[chosen]]
        for _ in range(environment.MAX_WAIT):
            if len(waiting) == 0:
                break
            self._run(waiting, still, results)
            waiting = waiting[~results.known[waiting]]
        if len(waiting) > 0:
            raise environment.no_pose(self._one.feedback)
        results.scores[chosen] = 0.0

    def _run(self, chosen: Indices, actions: Array, results: Results) -> None:
        """Move robots for one sampling time. Draw new noise for robots that have used their block of noise."""
        self._step(self._fleets, chosen, False, self._episodes, actions, results)
        self._draw_noise(chosen[self._episodes.steps[chosen] % _BLOCK == 0])

    def _draw_noise(self, chosen: Indices) -> None:
        noise, steps, run = self._episodes.noise, self._episodes.steps, self._one.config.run
        for index in chosen:
            self._source.rows(self._seeds[index], run, steps[index], noise[index], self._purposes)

    def _new_results(self) -> Results:
        n = self.num_envs
        poses = np.empty((n, 3)), np.empty((n, 3))
        return Results(np.empty((n, 7), np.float32), np.empty((n, 3)), *poses, np.empty(n, dtype=bool))

    def _observations(self, results: Results) -> Floats:
        space = cast(Box, self._one.observation_space)
        clipped: Floats = np.clip(results.observations, space.low, space.high, out=results.observations)
        return clipped

    def _infos(self, results: Results) -> dict[str, Any]:
        infos = {"truth": results.truth, "feedback": results.feedback, "is_success": results.scores[:, 1] > 0.0}
        return infos | {f"_{name}": np.ones(self.num_envs, dtype=bool) for name in infos}
