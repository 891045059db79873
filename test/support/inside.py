"""A robot in lock-step in the process of the test, without the imports of other processes."""

import contextlib
from functools import partial

import one_process
from geometry_msgs.msg import TwistStamped
from lockstep_drive import receive_all
from robot import DEEP, LOCKSTEP, TOPICS, Robot

from diffbot_control.ekf_node import EkfNode
from diffbot_control.robot_node import RobotControllerNode
from diffbot_sim.plant_node import PlantNode


class Inside(Robot):
    """The messages of nodes that share the executor of the test."""

    def catch_up(self):
        """Do nothing: the executor handles the messages of the test in order with all others."""

    def stop(self):
        """Pause the plant and receive all messages."""
        self.pause(True)
        receive_all(self)

    def run(self, condition, what):
        """Let the plant run until ``condition()`` is true."""
        self.pause(False)
        self.peer.spin_until(condition, what=what)
        self.stop()


@contextlib.contextmanager
def inside(plant=None, ekf=None, controller=None, arguments=()):
    """Run filter, controller and plant while the ``with`` block lasts, see robot.lockstep; ``arguments`` are of all."""
    given = {"plant": plant, "ekf": ekf, "controller": controller}
    given = {name: {**LOCKSTEP[name], **(one or {})} for name, one in given.items()}
    with one_process.nodes() as nodes:
        running = Inside(None, nodes.peer, "")
        running.commands = nodes.peer.subscribe(TwistStamped, "cmd_vel", DEEP)
        ekf_node = nodes.add(EkfNode, given["ekf"], arguments)
        nodes.add(partial(RobotControllerNode, ekf_node), given["controller"], arguments)
        nodes.add(PlantNode, given["plant"], arguments)
        nodes.peer.wait_for_publishers(*TOPICS["robot"], *TOPICS["plant"])
        yield running
