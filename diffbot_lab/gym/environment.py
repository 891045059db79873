"""``DiffbotGoal-v0``: drive the simulated robot to the pose (0, 0, 0) of map.

Plant, sensors, noise and filter are those of the simulation; one step is one sampling time (0.1 s by default)::

    import gymnasium

    env = gymnasium.make("diffbot_lab.gym:DiffbotGoal-v0")  # or its name alone, after `import diffbot_lab.gym`
    observation, info = env.reset(seed=1)
    observation, reward, terminated, truncated, info = env.step(env.action_space.sample())

Action, ``Box(-1, 1, (2,))``: shares of ``v_max`` [m/s] and ``omega_max`` [rad/s] of the data sheet, 1.3 and 2.6 by
default. The twist is then scaled down to the bound of the wheels, which keeps its curvature.

Observation, ``Box(7)``, from the pose that a controller would get (``feedback``), as float32:

====== ================== ======= ==================================================================
number value              unit    meaning
====== ================== ======= ==================================================================
0      rho                m       distance of the goal, at most twice the distance that ends an episode
1, 2   cos, sin of alpha  -       bearing of the goal in the robot's frame
3, 4   cos, sin of beta   -       bearing of the goal in the goal's frame; the heading is beta - alpha
5      v                  m/s     speed over the last step by the encoders, within 2 ``v_max``
6      omega              rad/s   turn rate over the last step by the encoders, within 2 ``omega_max``
====== ================== ======= ==================================================================

Reward of a step, from the true pose: the decrease of D = rho + 0.2 m/rad * abs(theta) [m], less 0.1 for each second,
plus 10 at the goal, less 10 for leaving the arena. An episode is terminated at the goal, where the true pose is within
the goal checker's tolerances (0.1 m, 0.1 rad) and the command at most 0.05 m/s and 0.1 rad/s, and where the true
distance exceeds three times ``start_range``. ``gymnasium.make`` truncates it after 300 steps.

Many at a time: ``gymnasium.make_vec("diffbot_lab.gym:DiffbotGoal-v0", num_envs=1024)``, see :mod:`vector`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

from diffbot_control.filter.localization import Localization
from diffbot_control.filter.localization_config import LocalizationConfig
from diffbot_control.law.goal_checker import GoalTolerance
from diffbot_core.data_sheet import DataSheet
from diffbot_core.errors import InvalidValueError
from diffbot_core.geometry import MAX_COORDINATE, Pose, wrap_angle
from diffbot_core.kinematics import Twist
from diffbot_lab.gym.task import Task, observed, requested, score
from diffbot_sim.feedback import EKF, FEEDBACKS
from diffbot_sim.model.simulator import StartPose, World, WorldConfig
from diffbot_sim.reference_loop import PoseFeedback

Floats = NDArray[np.float32]

ARENA = 3.0
"""times ``start_range``: a distance beyond it ends an episode"""
_RANGES = {"start_range": (0.1, 1e3), "v_max": (1e-3, 1e3), "omega_max": (1e-3, 1e3)}
MAX_WAIT = 1000
"""steps in which the robot waits for its first pose"""
_MAX_SEED = 2**63 - 1


class DiffbotGoalEnv(gymnasium.Env[Floats, Floats]):
    """The environment; the module describes action, observation and reward."""

    metadata = {"render_modes": ["rgb_array"], "render_fps": 10}  # noqa: RUF012 - as gymnasium has it

    def __init__(
        self,
        world: WorldConfig | None = None,
        feedback: str = EKF,
        data_sheet: DataSheet | None = None,
        start_range: float = 5.0,
        render_mode: str | None = None,
    ) -> None:
        """Describe the task.

        Args:
            world: plant, sensors and landmarks; None for the paper's robot. Start and seed are drawn by :meth:`reset`.
            feedback: one of FEEDBACKS: the filter's estimate, the newest fix, or the true pose.
            data_sheet: what an action of 1 means, and the bound of the wheels; None for the paper's robot.
            start_range: [m] x and y of the start are drawn uniformly within it, the heading from all directions.
            render_mode: None, or rgb_array: :meth:`render` draws the present state.

        Raises:
            InvalidValueError: for another feedback, or a range or bound that is not a positive number.
        """
        self.config, sheet = world or WorldConfig(), data_sheet or DataSheet()
        v_max, omega_max = sheet.v_max, sheet.omega_max
        if render_mode not in (None, *self.metadata["render_modes"]):
            raise InvalidValueError("render_mode", render_mode, "None or rgb_array")
        self.render_mode = render_mode
        if feedback not in FEEDBACKS:
            raise InvalidValueError("feedback", feedback, "one of " + ", ".join(FEEDBACKS))
        for name, value in (("start_range", start_range), ("v_max", v_max), ("omega_max", omega_max)):
            least, most = _RANGES[name]
            if not least <= value <= most:
                raise InvalidValueError(name, value, f">= {least:g} and <= {most:g}")
        self.feedback, self.start_range = feedback, start_range
        self.task = Task(sheet, GoalTolerance(), ARENA * start_range, self.config.plant.sampling_time)
        self.action_space = gymnasium.spaces.Box(-1.0, 1.0, (2,), np.float32)
        high = np.array([2.0 * ARENA * start_range, 1.0, 1.0, 1.0, 1.0, 2.0 * v_max, 2.0 * omega_max], np.float32)
        low = np.array([0.0, *(-high[1:])], np.float32)
        self.observation_space = gymnasium.spaces.Box(low, high, (7,), np.float32)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Floats, dict[str, Any]]:
        """Begin an episode, at rest; the robot stands until there is a first pose.

        Args:
            seed: of starts and noise, of this episode and those that follow; None goes on with the former one.
            options: ``start``: x [m], y [m], theta [rad] in map, instead of a random one.

        Returns:
            Observation and info: ``truth`` and ``feedback``, poses (3,) in map, and ``is_success``.

        Raises:
            InvalidValueError: for a bad start, or if no pose comes at all.
        """
        super().reset(seed=seed)
        start, noise = drawn_episode(self.np_random, self.start_range)
        if options and "start" in options:
            start = checked_start(options["start"])
        self.world = World(self.config._replace(start=start, seed=noise))
        separation, landmarks = self.config.plant.wheels.wheel_separation, bool(self.config.landmarks.landmark_ids)
        found = Localization(LocalizationConfig(), separation, landmarks=landmarks)
        self._source = PoseFeedback(self.feedback, found)
        pose, steps = self._source.pose(self.world), 0
        while pose is None:
            if steps == MAX_WAIT:
                raise no_pose(self.feedback)
            self.world.advance(Twist(0.0, 0.0))
            pose, steps = self._source.pose(self.world), steps + 1
        self._pose = pose
        return self._observation(), self._info(False)

    def step(self, action: Floats) -> tuple[Floats, float, bool, bool, dict[str, Any]]:
        """Drive for one sampling time; see the module.

        Raises:
            InvalidValueError: for an action that is not two finite numbers; others are clipped to the space.
        """
        v, omega = checked_actions(action, (2,)).tolist()
        command = requested(v, omega, self.task.data_sheet)
        before = self.world.state.pose
        self.world.advance(command)
        self._pose = self._source.pose(self.world) or self._pose
        reward, reached, left = score(before, self.world.state.pose, command, self.task)
        return self._observation(), reward, reached or left, False, self._info(reached)

    def render(self) -> NDArray[np.uint8] | None:
        """Return a picture (400, 400, 3) of the goal, the true robot and the estimate; None without a render_mode."""
        if self.render_mode is None:
            return None
        # Loads matplotlib.
        from matplotlib.backends.backend_agg import FigureCanvasAgg  # noqa: PLC0415
        from matplotlib.figure import Figure  # noqa: PLC0415

        canvas, reach = FigureCanvasAgg(Figure(figsize=(4.0, 4.0), dpi=100)), 1.2 * self.start_range
        axes = canvas.figure.add_axes((0.0, 0.0, 1.0, 1.0), xlim=(-reach, reach), ylim=(-reach, reach), aspect="equal")
        for pose, colour in ((Pose(0.0, 0.0, 0.0), "green"), (self._pose, "red"), (self.world.state.pose, "blue")):
            tip = 0.12 * reach * math.cos(pose.theta), 0.12 * reach * math.sin(pose.theta)
            axes.quiver(pose.x, pose.y, *tip, color=colour, angles="xy", scale_units="xy", scale=1.0)
        canvas.draw()  # type: ignore[no-untyped-call]
        return np.array(canvas.buffer_rgba())[:, :, :3]  # type: ignore[no-untyped-call]

    def _observation(self) -> Floats:
        _, twist, _ = self.world.odometry()
        values = np.array(observed(self._pose, twist), dtype=np.float32)
        space = self.observation_space
        clipped: Floats = np.clip(values, space.low, space.high)  # type: ignore[attr-defined] # it is a Box
        return clipped

    def _info(self, reached: bool) -> dict[str, Any]:
        return {
            "truth": np.array(self.world.state.pose),
            "feedback": np.array(self._pose),
            "is_success": reached,
        }


def no_pose(feedback: str) -> InvalidValueError:
    """Return the error of a robot that never learns where it is."""
    return InvalidValueError("feedback", feedback, f"one that brings a pose within {MAX_WAIT} steps")


def drawn_episode(generator: np.random.Generator, start_range: float) -> tuple[StartPose, int]:
    """Draw the start of an episode, x and y within ``start_range`` [m], and the seed of its noise."""
    x, y, turn = generator.uniform(-1.0, 1.0, 3).tolist()
    start = StartPose(start_range * x, start_range * y, math.pi * turn)
    return start, int(generator.integers(_MAX_SEED, endpoint=True))


def checked_actions(action: Any, shape: tuple[int, ...]) -> NDArray[np.float64]:
    """Return an action, or one for each environment, clipped to the space.

    Raises:
        InvalidValueError: for one of another shape, or a number that is not finite.
    """
    shares = np.asarray(action, dtype=np.float64)
    if shares.shape != shape or not np.isfinite(shares).all():
        what = "two finite numbers" if shape == (2,) else f"finite numbers of shape {shape}"
        raise InvalidValueError("action", action, what)
    return np.clip(shares, -1.0, 1.0)


def checked_start(start: Sequence[float]) -> StartPose:
    """Return x [m], y [m], theta [rad] as a start."""
    values = np.asarray(start, dtype=np.float64)
    if values.shape != (3,) or not (np.abs(values) <= MAX_COORDINATE).all():
        raise InvalidValueError("start", start, f"x, y, theta, each within {MAX_COORDINATE:g}")
    x, y, theta = values.tolist()
    return StartPose(x, y, wrap_angle(theta))
