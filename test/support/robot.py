"""The robot of the graph tests: plant, filter and controller as processes, and their messages."""

import contextlib
import math
import time

import graph
import numpy as np
from action_msgs.msg import GoalStatusArray
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped, Twist, TwistStamped
from nav_msgs.msg import Odometry, Path
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile
from std_srvs.srv import SetBool, Trigger

from diffbot_control.goals import goal_id

SIMULATED = {"use_sim_time": True}
ON_TRUTH, TRUE_POSES = {"pose_source": "odometry"}, ("-r", "controller:odometry/filtered:=ground_truth")
"""Parameters and arguments of a controller that receives the true poses of the plant."""
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
DEEP = QoSProfile(depth=100_000)
"""The test may handle messages late: the queue must not drop any."""


def kept(*topics):
    """Return the parameters with which publishers keep many messages for a test that is held up."""
    return {f"qos_overrides.{topic}.publisher.depth": 1000 for topic in topics}


LOCKSTEP = {
    "plant": {
        **{"clock": "lockstep", "start_paused": True, "start_time": 1000.0, "cmd_vel_type": "twist_stamped"},
        **kept("/ground_truth", "/clock"),
    },
    "ekf": {"reliable_inputs": True, **SIMULATED, **kept("/pose")},
    "controller": {
        **{"publish_when_idle": True, "reliable_inputs": True, "cmd_vel_type": "twist_stamped"},
        **{**SIMULATED, **kept("/cmd_vel")},
    },
}
"""Parameters of a robot that runs as fast as it goes."""
TOPICS = {
    "plant": ("ground_truth",),
    "ekf": ("pose", "ekf/status"),
    "controller": ("cmd_vel", "controller/status"),
    "robot": ("pose", "ekf/status", "cmd_vel", "controller/status"),
}
"""Topics of each node that the test subscribes to."""


def yaw(orientation):
    return 2.0 * math.atan2(orientation.z, orientation.w)


def planar(pose):
    return pose.position.x, pose.position.y, yaw(pose.orientation)


def stamp(message):
    return message.header.stamp.sec * 10**9 + message.header.stamp.nanosec


def pose_stamped(x, y, theta, frame="map"):
    message = PoseStamped()
    message.header.frame_id = frame
    message.pose.position.x, message.pose.position.y = float(x), float(y)
    message.pose.orientation.z, message.pose.orientation.w = math.sin(theta / 2), math.cos(theta / 2)
    return message


def stamped_goal(*poses, frame="map", at=None):
    """Return the id of a new goal, or of a path of several poses, and its message; ``at`` [ns] is its stamp."""
    at = time.time_ns() if at is None else at
    message = (
        pose_stamped(*poses[0], frame) if len(poses) == 1 else Path(poses=[pose_stamped(*one, frame) for one in poses])
    )
    message.header.frame_id = frame
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(at, 10**9)
    return goal_id(frame, at), message


def distance(pose, goal):
    return math.hypot(pose[0] - goal[0], pose[1] - goal[1])


def turned(pose, goal):
    return abs(math.remainder(pose[2] - goal[2], 2 * math.pi))


class Robot:
    """The processes of one robot, and lists of the received messages, which grow while the test's node spins."""

    def __init__(self, stack, peer, namespace):
        self._stack = stack
        self.peer = peer
        self.namespace = namespace
        self._remapped = ("-r", f"__ns:={namespace}") if namespace else ()
        self.processes = {}
        self.launched = []
        self.truths = peer.subscribe(Odometry, "ground_truth", DEEP)
        self.poses = peer.subscribe(PoseWithCovarianceStamped, "pose", DEEP)
        self.controller_states = peer.subscribe(DiagnosticStatus, "controller/status", LATCHED)
        self.ekf_states = peer.subscribe(DiagnosticStatus, "ekf/status", LATCHED)
        self.diagnostics = peer.subscribe(DiagnosticArray, "/diagnostics", DEEP)
        self.goal_states = peer.subscribe(GoalStatusArray, "controller/goal_status", LATCHED)
        self.goal_results = peer.subscribe(DiagnosticArray, "controller/goal_results", LATCHED)
        self.goals = peer.publisher(PoseStamped, "goal_pose")
        self.paths = peer.publisher(Path, "path")
        self.commands = []

    def start(self, name, parameters=None):
        process = self.launch(name, parameters)
        self.wait_until_ready(name)
        return process

    def wait_until_ready(self, *names):
        """Wait until the nodes log that they are ready, and the test has discovered their publishers."""
        for name in names:
            text = f"{'controller' if name == 'robot' else name}]: ready"
            self.processes[name].wait_for_output(text)
        for name in names:
            self.peer.wait_for_publishers(*TOPICS[name])

    def launch(self, name, parameters=None, arguments=(), **options):
        """Start one of the nodes without waiting; ``options`` are of subprocess.Popen."""
        arguments = (*arguments, *self._remapped)
        process = self._stack.enter_context(graph.node(graph.MODULES[name], parameters, arguments, **options))
        self.processes[name] = process
        self.launched.append(process)
        return process

    def launch_joined(self, names, parameters, arguments=(), **options):
        ros = *graph.ros_arguments(parameters), *arguments, *self._remapped
        words = ("run", names[0], "--with", *names[1:], "--ros-args", *ros)
        process = self._stack.enter_context(graph.diffbot(*words, **options))
        self.processes.update(dict.fromkeys(names, process))
        self.launched.append(process)

    def state(self):
        return self.controller_states[-1].message if self.controller_states else ""

    def goal(self):
        """Return the goal that the controller's newest status names; empty without a goal."""
        text = graph.values(self.controller_states[-1]).get("goal", "") if self.controller_states else ""
        return tuple(map(float, text.split()))

    def wait_for_state(self, state, timeout=15.0):
        self.peer.spin_until(lambda: self.state() == state, timeout, f"the controller's state {state!r}")

    def catch_up(self):
        """Handle all received messages, so that the last messages in the lists are the newest ones."""
        self.peer.drain()

    def true_pose(self):
        self.catch_up()
        self.peer.spin_until(lambda: self.truths, what="a true pose")
        return planar(self.truths[-1].pose.pose)

    def send_goal(self, *goal, tries=1):
        """Send a goal and wait until the controller's status names it.

        A controller that has just started may not have discovered this publisher yet, and needs more ``tries``.
        """
        self.peer.wait_for_subscribers(self.goals)

        def known():
            return self.goal() and np.allclose(self.goal(), goal, rtol=0.0, atol=5e-5)

        for left in reversed(range(tries)):
            self.goals.publish(pose_stamped(*goal))
            if self.peer.comes_true(known, 5.0 if left else graph.PATIENCE):
                return
        raise AssertionError(f"the controller's status does not name the goal {goal}")

    def accepted(self):
        """Return the status of each goal by its id in the newest goal_status, the newest goal last."""
        self.catch_up()
        newest = self.goal_states[-1].status_list if self.goal_states else []
        return {bytes(one.goal_info.goal_id.uuid).hex(): one.status for one in newest}

    def ends(self):
        """Return end and reason of each goal by its id in the newest goal_results."""
        self.catch_up()
        newest = self.goal_results[-1].status if self.goal_results else []
        return {one.name: (one.message, graph.values(one)["reason"]) for one in newest}

    def send_stamped(self, *poses, **options):
        """Send a goal or a path, see :func:`stamped_goal`, and wait for its acceptance or its end; return its id."""
        goal_id, message = stamped_goal(*poses, **options)
        publisher = self.goals if len(poses) == 1 else self.paths
        self.peer.wait_for_subscribers(publisher)
        publisher.publish(message)
        self.peer.spin_until(lambda: goal_id in self.accepted() or goal_id in self.ends(), what="the goal")
        return goal_id

    def wait_for_end(self, goal_id):
        return self.peer.spin_until(lambda: self.ends().get(goal_id), what="the end of the goal")

    def pause(self, paused):
        return self.peer.call(SetBool, "plant/pause", SetBool.Request(data=paused))

    def set_parameter(self, node, name, value):
        request = SetParameters.Request(parameters=[Parameter(name, value=value).to_parameter_msg()])
        return self.peer.call(SetParameters, f"{node}/set_parameters", request).results[0]

    def cancel(self):
        return self.peer.call(Trigger, "controller/cancel")

    def diagnosis(self, name):
        """Return the key-value pairs of a report of a node on /diagnostics that is sent after this call."""
        self.catch_up()
        before = len(self.diagnostics)
        full = f"{self.namespace}/{name}"

        def following():
            news = [status for array in self.diagnostics[before:] for status in array.status if status.name == full]
            # The first report may have been sent before the call.
            return news[1] if len(news) > 1 else None

        return graph.values(self.peer.spin_until(following, what=f"{full} on /diagnostics"))


@contextlib.contextmanager
def robot(
    plant=None,
    ekf=None,
    controller=None,
    namespace="",
    *,
    only=("ekf", "controller", "plant"),
    stamped=False,
    arguments=None,
    joined=False,
    **options,
):
    """Run a robot with parameters of its nodes while the ``with`` block lasts.

    ``only`` are the nodes to start; ``robot`` is filter and controller in one process. ``arguments`` are other ROS
    arguments by node. With ``joined`` all nodes run in one process, which needs a third of the processor time;
    ``arguments`` are then of this process. ``options`` are of subprocess.Popen.
    """
    given = {"plant": plant, "ekf": ekf, "controller": controller}
    given["robot"] = by_node(given, "ekf", "controller")
    with contextlib.ExitStack() as stack:
        peer = stack.enter_context(graph.peer(namespace=namespace or None))
        running = Robot(stack, peer, namespace)
        running.commands = peer.subscribe(TwistStamped if stamped else Twist, "cmd_vel", DEEP)
        if joined:
            running.launch_joined(only, by_node(given, "plant", "ekf", "controller"), arguments or (), **options)
        else:
            for name in only:
                running.launch(name, given[name], (arguments or {}).get(name, ()), **options)
        running.wait_until_ready(*only)
        yield running


def by_node(given, *nodes):
    """Return the parameters of several nodes in one process, with the name of the node before each."""
    return {f"{node}:{name}": value for node in nodes for name, value in (given[node] or {}).items()}


def on_truth(plant=None, controller=None, **options):
    """Run plant and controller in one process without a filter: the controller receives the true poses."""
    nodes = {"plant": plant, "controller": {**ON_TRUTH, **(controller or {})}}
    return robot(**nodes, only=("controller", "plant"), joined=True, arguments=TRUE_POSES, **options)


def lockstep(plant=None, ekf=None, controller=None, **options):
    """Run a robot in lock-step, which is paused until ``pause(False)``."""
    given = {"plant": plant, "ekf": ekf, "controller": controller}
    return robot(**{name: {**LOCKSTEP[name], **(one or {})} for name, one in given.items()}, stamped=True, **options)


def twist(command):
    twist = getattr(command, "twist", command)
    return twist.linear.x, twist.angular.z


def initialpose(x, y, theta):
    message = PoseWithCovarianceStamped()
    message.header.frame_id = "map"
    message.pose.pose.position.x, message.pose.pose.position.y = x, y
    message.pose.pose.orientation.z, message.pose.pose.orientation.w = np.sin(theta / 2), np.cos(theta / 2)
    message.pose.covariance[[0, 7, 35]] = 1e-4
    return message
