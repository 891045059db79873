"""``DiffbotGoal-v0``: drive the simulated robot to the pose (0, 0, 0) in the frame map.

Plant, sensors, noise and filter are the same as in the simulation. A step lasts one sampling time, 0.1 s by default::

    import gymnasium

    env = gymnasium.make("diffbot_lab.gym:DiffbotGoal-v0")
    observation, info = env.reset(seed=1)
    observation, reward, terminated, truncated, info = env.step(env.action_space.sample())

An action, ``Box(-1, 1, (2,))``, contains v and omega as shares of ``v_max`` and ``omega_max`` of the data sheet, which
are 1.3 m/s and 2.6 rad/s by default. If a wheel would exceed its limit, v and omega are scaled down by one factor.

An observation, ``Box(7)`` of float32, is calculated from the pose that a controller would receive (``feedback``):

====== ================== ======= ==================================================================
number value              unit    meaning
====== ================== ======= ==================================================================
0      rho                m       distance to the goal, clipped at twice the distance that ends an episode
1, 2   cos, sin of alpha  -       bearing of the goal in the robot's frame
3, 4   cos, sin of beta   -       bearing of the goal in the goal's frame; the heading is beta - alpha
5      v                  m/s     mean speed over the last step from the encoders, clipped at 2 ``v_max``
6      omega              rad/s   mean turn rate over the last step, clipped at 2 ``omega_max``
====== ================== ======= ==================================================================

The reward of a step is calculated from the true pose. It is the decrease of D = rho + 0.2 m/rad * abs(theta) [m], minus
0.1 per second. Reaching the goal adds 10, and leaving the arena subtracts 10.

The goal is reached if the true pose is within the goal checker's tolerances (0.1 m, 0.1 rad) and the command is at most
0.05 m/s and 0.1 rad/s. The robot leaves the arena if its true distance from the goal exceeds three times
``start_range``. Both terminate the episode. ``gymnasium.make`` truncates it after 300 steps.

For many environments, use ``gymnasium.make_vec("diffbot_lab.gym:DiffbotGoal-v0", num_envs=1024)``, see :mod:`vector`.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import gymnasium
import numpy as np
from numpy.typing import NDArray

from diffbot_control.filter.config import LocalizationConfig
from diffbot_control.law.goal_checker import GoalTolerance, within
from diffbot_control.law.limits import limit_velocity
from diffbot_control.law.steering import navigation_variables
from diffbot_core.data_sheet import DataSheet
from diffbot_core.errors import InvalidValueError
from diffbot_core.geometry import MAX_COORDINATE, Pose, wrap_angle
from diffbot_core.kinematics import Twist, body_twist
from diffbot_sim.config import StartPose, WorldConfig
from diffbot_sim.fusion import new_buffers
from diffbot_sim.noise import NoiseSource, quiet_noise
from diffbot_sim.robot_step import EKF, FEEDBACKS, SENSES, TRUTH, advance, check_robot, start
from diffbot_sim.sensors import purposes_of
from diffbot_sim.simulation import simulated_robot

Floats = NDArray[np.float32]

ARENA = 3.0
"""radius of the arena as a multiple of ``start_range``"""
HEADING_WEIGHT = 0.2
"""[m/rad] weight of the heading error in the distance D of the reward"""
TIME_COST, END_REWARD = 0.1, 10.0
"""[1/s] cost of time; reward for reaching the goal, and cost of leaving the arena"""
MAX_WAIT = 1000
"""largest number of steps for which the robot waits for its first pose"""
_MAX_SEED = 2**63 - 1


class Task(NamedTuple):
    """Values that determine rewards and ends of episodes."""

    data_sheet: DataSheet
    tolerance: GoalTolerance
    arena: float
    """[m] distance from the goal beyond which the robot has left the arena"""
    sampling_time: float
    """[s]"""


def command_of(v: float, omega: float, data_sheet: DataSheet) -> Twist:
    """Return the command for v and omega as shares (-1 to 1) of v_max and omega_max, within the wheel speed limit."""
    return limit_velocity(Twist(v * data_sheet.v_max, omega * data_sheet.omega_max), data_sheet)


def observation_of(pose: Pose, twist: Twist) -> tuple[float, float, float, float, float, float, float]:
    """Return the observation for a pose in the goal's frame and the twist of the encoders, without clipping."""
    rho, alpha, beta = navigation_variables(pose)
    return rho, math.cos(alpha), math.sin(alpha), math.cos(beta), math.sin(beta), twist.v, twist.omega


def score(before: Pose, after: Pose, command: Twist, task: Task) -> tuple[float, bool, bool]:
    """Return the reward of a step, True if the goal is reached, and True if the robot has left the arena.

    ``before`` and ``after`` are true poses in the goal's frame.
    """
    rho = math.hypot(after.x, after.y)
    reached = within(after, rho, command, task.tolerance, task.data_sheet)
    left = rho > task.arena
    reward = distance(before) - distance(after) - TIME_COST * task.sampling_time
    if reached:
        reward += END_REWARD
    if left:
        reward -= END_REWARD
    return reward, reached, left


def distance(pose: Pose) -> float:
    """Return the distance D [m] of the reward for a pose in the goal's frame."""
    return math.hypot(pose.x, pose.y) + HEADING_WEIGHT * abs(pose.theta)


class DiffbotGoalEnv(gymnasium.Env[Floats, Floats]):
    """The environment, see :mod:`environment` for actions, observations and rewards."""

    metadata = {"render_modes": ["rgb_array"], "render_fps": 10}  # noqa: RUF012 - gymnasium declares it so

    def __init__(
        self,
        world: WorldConfig | None = None,
        feedback: str = EKF,
        data_sheet: DataSheet | None = None,
        start_range: float = 5.0,
        render_mode: str | None = None,
    ) -> None:
        """Create the environment.

        Args:
            world: plant, sensors and landmarks; None for the paper's robot. Its start and seed are replaced by
                :meth:`reset`.
            feedback: pose of the observations: ``ekf``, the filter's estimate; ``raw``, the newest fix; or ``truth``.
            data_sheet: v_max and omega_max, the speeds of an action of 1, and wheel_max; None for the paper's robot.
            start_range: [m] bound of |x| and |y| of random starts.
            render_mode: None, or ``rgb_array`` for :meth:`render`.

        Raises:
            InvalidValueError: for an unknown feedback or render_mode, a range or speed that is not above 0 and at most
                1000, or sensors that :func:`robot_step.check_robot` refuses.
        """
        self.config, sheet = world or WorldConfig(), data_sheet or DataSheet()
        v_max, omega_max = sheet.v_max, sheet.omega_max
        if render_mode not in (None, *self.metadata["render_modes"]):
            raise InvalidValueError("render_mode", render_mode, "None or rgb_array")
        if feedback not in FEEDBACKS:
            raise InvalidValueError("feedback", feedback, "one of " + ", ".join(FEEDBACKS))
        for name, value in (("start_range", start_range), ("v_max", v_max), ("omega_max", omega_max)):
            if not 0.0 < value <= 1e3:
                raise InvalidValueError(name, value, "> 0 and <= 1000")
        self.render_mode, self.feedback, self.start_range, self.world = render_mode, feedback, start_range, self.config
        self.robot = simulated_robot(self.config)
        if feedback != TRUTH:
            check_robot(self.robot, LocalizationConfig().history_length)
        self._buffers, self._source = new_buffers(self.robot), NoiseSource()
        self._noise = quiet_noise(len(self.robot.landmarks))
        self.task = Task(sheet, GoalTolerance(), ARENA * start_range, self.config.plant.sampling_time)
        self.action_space = gymnasium.spaces.Box(-1.0, 1.0, (2,), np.float32)
        high = np.array([2.0 * ARENA * start_range, 1.0, 1.0, 1.0, 1.0, 2.0 * v_max, 2.0 * omega_max], np.float32)
        low = np.array([0.0, *(-high[1:])], np.float32)
        self.observation_space = gymnasium.spaces.Box(low, high, (7,), np.float32)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Floats, dict[str, Any]]:
        """Begin an episode. The robot stands still until its first pose arrives.

        Args:
            seed: seed of starts and noise for this episode and the episodes after it; None to continue the random
                numbers of the previous episode.
            options: ``start``, a pose x [m], y [m], theta [rad] in map; without it, the start is random.

        Returns:
            Observation and info. The info contains ``truth`` and ``feedback``, which are poses (3,) in map, and
            ``is_success``.

        Raises:
            InvalidValueError: for a start that is not a pose, or if no pose arrives within MAX_WAIT steps.
        """
        super().reset(seed=seed)
        begin, noise_seed = draw_episode(self.np_random, self.start_range)
        if options and "start" in options:
            begin = checked_start(options["start"])
        self.world = self.config._replace(start=begin, seed=noise_seed)
        self._state = start(self._buffers, Pose(*begin))
        self._sense()
        while not self._state.feedback.known:
            if self._state.plant.step == MAX_WAIT:
                raise no_pose(self.feedback)
            self._advance(Twist(0.0, 0.0))
        return self._observation(), self._info(False)

    def step(self, action: Floats) -> tuple[Floats, float, bool, bool, dict[str, Any]]:
        """Move the robot for one sampling time. The action is clipped to the action space.

        Raises:
            InvalidValueError: for an action that is not two finite numbers.
        """
        v, omega = checked_actions(action, (2,)).tolist()
        command = command_of(v, omega, self.task.data_sheet)
        before = self._state.plant.pose
        self._advance(command)
        reward, reached, left = score(before, self._state.plant.pose, command, self.task)
        return self._observation(), reward, reached or left, False, self._info(reached)

    def _sense(self) -> None:
        sensors, slip_noise, state = self.robot.sensors, self.robot.plant.slip_noise, self._state.plant
        purposes = purposes_of(sensors, len(self.robot.landmarks), slip_noise)
        self._source.rows(self.world.seed, self.world.run, state.step, self._noise, purposes)
        sense, sampling_time = SENSES[FEEDBACKS.index(self.feedback)], self.robot.plant.sampling_time
        self._state = sense(self._state, self._buffers, self._noise[:, 0], sensors, sampling_time)

    def _advance(self, command: Twist) -> None:
        self._state = advance(self._state, self._buffers.commands, command, self._noise[:, 0], self.robot.plant)
        self._sense()

    def render(self) -> NDArray[np.uint8] | None:
        """Return a picture (400, 400, 3) of the goal, the true robot and the estimate; None without a render_mode."""
        if self.render_mode is None:
            return None
        # Matplotlib takes long to load.
        from matplotlib.backends.backend_agg import FigureCanvasAgg  # noqa: PLC0415
        from matplotlib.figure import Figure  # noqa: PLC0415

        canvas, reach = FigureCanvasAgg(Figure(figsize=(4.0, 4.0), dpi=100)), 1.2 * self.start_range
        axes = canvas.figure.add_axes((0.0, 0.0, 1.0, 1.0), xlim=(-reach, reach), ylim=(-reach, reach), aspect="equal")
        poses = Pose(0.0, 0.0, 0.0), self._state.feedback.pose, self._state.plant.pose
        for pose, colour in zip(poses, ("green", "red", "blue"), strict=True):
            tip = 0.12 * reach * math.cos(pose.theta), 0.12 * reach * math.sin(pose.theta)
            axes.quiver(pose.x, pose.y, *tip, color=colour, angles="xy", scale_units="xy", scale=1.0)
        canvas.draw()  # type: ignore[no-untyped-call]
        return np.array(canvas.buffer_rgba())[:, :, :3]  # type: ignore[no-untyped-call]

    def _observation(self) -> Floats:
        twist = body_twist(self._state.plant.encoder, self.robot.plant.wheels)
        values = np.array(observation_of(self._state.feedback.pose, twist), dtype=np.float32)
        space = self.observation_space
        clipped: Floats = np.clip(values, space.low, space.high)  # type: ignore[attr-defined] # the space is a Box
        return clipped

    def _info(self, reached: bool) -> dict[str, Any]:
        truth, feedback = np.array(self._state.plant.pose), np.array(self._state.feedback.pose)
        return {"truth": truth, "feedback": feedback, "is_success": reached}


def no_pose(feedback: str) -> InvalidValueError:
    """Return the error for a robot that receives no pose in MAX_WAIT steps."""
    return InvalidValueError("feedback", feedback, f"a feedback that has a pose within the first {MAX_WAIT} steps")


def draw_episode(generator: np.random.Generator, start_range: float) -> tuple[StartPose, int]:
    """Draw the start of an episode, with |x| and |y| up to ``start_range`` [m], and the seed of its noise."""
    x, y, turn = generator.uniform(-1.0, 1.0, 3).tolist()
    start = StartPose(start_range * x, start_range * y, math.pi * turn)
    return start, int(generator.integers(_MAX_SEED, endpoint=True))


def checked_actions(action: Any, shape: tuple[int, ...]) -> NDArray[np.float64]:
    """Return actions as an array of this ``shape``, clipped to the action space.

    Raises:
        InvalidValueError: for another shape, or for numbers that are not finite.
    """
    shares = np.asarray(action, dtype=np.float64)
    if shares.shape != shape or not np.isfinite(shares).all():
        raise InvalidValueError("action", action, f"finite numbers of shape {shape}")
    return np.clip(shares, -1.0, 1.0)


def checked_start(start: Any) -> StartPose:
    """Return x [m], y [m], theta [rad] as a start pose."""
    values = np.asarray(start, dtype=np.float64)
    if values.shape != (3,) or not (np.abs(values) <= MAX_COORDINATE).all():
        raise InvalidValueError("start", start, f"three numbers x, y, theta within +-{MAX_COORDINATE:g}")
    x, y, theta = values.tolist()
    return StartPose(x, y, wrap_angle(theta))
