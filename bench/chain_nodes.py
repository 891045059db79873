"""Child process of the benchmark: one or more nodes of a chain on one executor.

``python chain_nodes.py SCENARIO SIDE NODES SECONDS``; NODES is a comma-separated part of ``source,filter,control``.

- SCENARIO ``clocked``: the source is :class:`ClockedSource`, the same on both sides, a bare publisher
  and subscriber that sends odometry at 50 Hz and fixes at 10 Hz and times the commands that come back.
  ``lockstep``: the source is a plant that takes its next step when the command of this one has come.
- SIDE ``ours``: EkfNode, ControllerNode and PlantNode on the executor that diffbot_core.ros.node chooses.
  ``robot``: filter and controller as robot_node has them, the pose handed over by a call.
  ``bare``: relays without any work on the SingleThreadedExecutor.

The process of the source prints two JSON lines, ``{"event": "begin"}`` when the chain has warmed up and
``{"event": "end", ...}`` with what it measured, and ends; the others run until SIGINT. Filter and controller in one
process without the source then print ``{"event": "inside", ...}``: milliseconds from each callback of the odometry to
the return of the publication of its command.
"""

# Nodes of this stack are imported where they are made: the filter's libraries take a second, which relays and drivers
# need not wait for.

from __future__ import annotations

import math
import signal
import sys
import time
from typing import TYPE_CHECKING, Any

import rclpy
from bare_nodes import GOAL, BarePlant, ClockedSource, OdometryRelay, TwistRelay, report
from geometry_msgs.msg import PoseStamped
from rclpy.executors import Executor, ExternalShutdownException, SingleThreadedExecutor
from rclpy.parameter import Parameter
from rclpy.signals import SignalHandlerOptions

from diffbot_control.ros.messages.conversions import goal_message
from diffbot_core.ros.node import SPIN_TIMEOUT, make_executor, run_together

if TYPE_CHECKING:
    from diffbot_control.controller_node import ControllerNode
    from diffbot_control.ekf_node import EkfNode
    from diffbot_control.ros.controller_publishers import ControllerPublishers
    from diffbot_sim.plant_node import PlantNode

CLOCKED, LOCKSTEP = "clocked", "lockstep"
OURS, BARE, ROBOT = "ours", "bare", "robot"
SOURCE, FILTER, CONTROL = "source", "filter", "control"
_WARM_UP = 0.3
"""[s] of lock-step before the measurement."""
_LIFE = 120
"""[s] that a process may live beyond its measurement."""


class StepRate:
    """Steps per second of a lock-step plant, looked at after each callback; the first moments do not count."""

    def __init__(self, seconds: float) -> None:
        self.seconds = seconds
        self.done = False
        self.began = self.first = 0.0
        self.first_step = 0
        self.measuring = False

    def look(self, step: int) -> None:
        now = time.monotonic()
        if self.measuring:
            # Not before a step is made: a chain that was held up would have no rate.
            if now - self.began >= self.seconds and step > self.first_step:
                self.done = True
                report("end", rate=(step - self.first_step) / (now - self.began))
        elif step > 1:
            self.first = self.first or now
            if now - self.first > _WARM_UP:
                self.measuring, self.began, self.first_step = True, now, step
                report("begin")


def make_filter(scenario: str) -> EkfNode:
    """Create the filter with its default options."""
    from diffbot_control.ekf_node import EkfNode

    return EkfNode(parameter_overrides=[reliable_inputs(scenario)])


def make_control(scenario: str) -> ControllerNode:
    """Create the controller with its default options; in lock-step it answers from the first pose on, goal or not."""
    from diffbot_control.controller_node import ControllerNode

    overrides = [Parameter("publish_when_idle", value=True)] if scenario == LOCKSTEP else []
    return ControllerNode(parameter_overrides=[*overrides, reliable_inputs(scenario)])


def make_plant() -> PlantNode:
    """Create the plant in lock-step; by its defaults a fix comes in each step (10 Hz, Ts 0.1 s)."""
    from diffbot_sim.plant_node import PlantNode

    return PlantNode(parameter_overrides=[Parameter("clock", value=LOCKSTEP)])


def reliable_inputs(scenario: str) -> Parameter:
    """Return the parameter by which a node loses no message in lock-step."""
    return Parameter("reliable_inputs", value=scenario == LOCKSTEP)


def make_nodes(scenario: str, side: str, names: list[str], seconds: float) -> list[Any]:
    """Create the nodes of this process, the source (if it is among them) first."""
    # In lock-step the chain to beat has neither parameter services nor rosout; at 50 Hz it is as rclpy makes it.
    lean = {"start_parameter_services": False, "enable_rosout": False} if scenario == LOCKSTEP else {}
    makers = {
        FILTER: (lambda: make_filter(scenario)) if side == OURS else lambda: OdometryRelay(**lean),
        CONTROL: (lambda: make_control(scenario)) if side == OURS else lambda: TwistRelay(**lean),
    }
    if scenario == CLOCKED:
        makers[SOURCE] = lambda: ClockedSource(seconds)
    else:
        makers[SOURCE] = make_plant if side == OURS else lambda: BarePlant(**lean)
    return [makers[name]() for name in (SOURCE, FILTER, CONTROL) if name in names]


def spin_once(executor: Executor) -> None:
    """One turn: without a timeout, as ``spin()`` does, where that works; see make_executor."""
    executor.spin_once(timeout_sec=None if type(executor) is SingleThreadedExecutor else SPIN_TIMEOUT)


def give_goal(plant: PlantNode, executor: Executor) -> None:
    """Wait for the controller and give it the goal; the plant starts by itself when the graph is complete."""
    goals = plant.create_publisher(PoseStamped, "goal_pose", 10)
    while not goals.get_subscription_count():
        executor.spin_once(timeout_sec=SPIN_TIMEOUT)
    goals.publish(goal_message(GOAL, "map", plant._plant.world.stamp))


def measure(scenario: str, side: str, nodes: list[Any], seconds: float) -> None:
    """Spin until the source has measured."""
    # Alone in its process, the clocked source is the driver of both sides, and the same one down to its executor.
    is_driver = scenario == CLOCKED and len(nodes) == 1
    executor = SingleThreadedExecutor() if side == BARE and not is_driver else make_executor()
    for node in nodes:
        executor.add_node(node)
    source = nodes[0]
    if scenario == CLOCKED:
        while not source.done:
            spin_once(executor)
        return
    rate = StepRate(seconds)
    if side == OURS:
        give_goal(source, executor)
        while not rate.done:
            spin_once(executor)
            rate.look(source._plant.step)
    else:
        while not rate.done:
            spin_once(executor)
            rate.look(source.step)


def relay_forever(scenario: str, side: str, names: list[str]) -> None:
    """Run nodes of the other side until SIGINT, as their user would: ``spin`` of the default executor."""
    rclpy.init()
    try:
        executor = SingleThreadedExecutor()
        for node in make_nodes(scenario, side, names, 0.0):
            executor.add_node(node)
        executor.spin()
    except (KeyboardInterrupt, ExternalShutdownException):
        pass


def work_forever(scenario: str, side: str, names: list[str]) -> int:
    """Run nodes of this stack until SIGINT as their executables do; return the exit status."""
    watch = Watch() if {FILTER, CONTROL} <= set(names) else None
    if side == ROBOT:
        from diffbot_control.robot_node import make_nodes as make_robot

        status = run_together(make_robot)
    else:
        status = run_together(lambda: iter(make_nodes(scenario, side, names, 0.0)))
    if watch is not None:
        report("inside", durations=watch.durations)
    return status


class Watch:
    """Times from each callback of the odometry to the return of the publication of its command."""

    def __init__(self) -> None:
        """Watch all nodes that this process makes from now on."""
        from diffbot_control import ekf_node
        from diffbot_control.ros.controller_publishers import ControllerPublishers

        self.durations: list[float] = []
        self.began = 0
        read, send = ekf_node.read_odometry, ControllerPublishers.send

        def timed_read(data: bytes) -> Any:
            self.began = time.perf_counter_ns()
            return read(data)

        def timed_send(publishers: ControllerPublishers, *arguments: Any) -> None:
            send(publishers, *arguments)
            self.durations.append((time.perf_counter_ns() - self.began) * 1e-6)

        ekf_node.read_odometry, ControllerPublishers.send = timed_read, timed_send


def main() -> int:
    """Run the nodes named on the command line."""
    scenario, side, names, seconds = sys.argv[1], sys.argv[2], sys.argv[3].split(","), float(sys.argv[4])
    # Whatever goes wrong, here or in the parent: nothing runs on for ever.
    signal.alarm(math.ceil(seconds) + _LIFE)
    if SOURCE not in names:
        if side in (OURS, ROBOT):
            return work_forever(scenario, side, names)
        relay_forever(scenario, side, names)
        return 0
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    nodes = make_nodes(scenario, side, names, seconds)
    measure(scenario, side, nodes, seconds)
    for node in nodes:
        node.destroy_node()
    rclpy.try_shutdown()
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
