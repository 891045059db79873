"""Fixtures of the tests of the graph."""

import fcntl
import importlib
import sys

import graph
import pytest


@pytest.fixture
def nodes():
    """Run nodes in a new context: publishers stay in the graph as long as an executor holds their handles."""
    import one_process

    with one_process.nodes() as running:
        yield running


class ActionPeer:
    """A client of an action of Nav2 on the node of a peer. ``name`` is the name of the action and of its type."""

    def __init__(self, peer, name):
        from nav2_msgs import action
        from rclpy.action import ActionClient

        self.peer, self.feedback = peer, []
        self.type = getattr(action, name.title().replace("_", ""))
        self.client = ActionClient(peer.node, self.type, name)
        peer.spin_until(self.client.server_is_ready, what=f"the action {name}")

    def send(self, on_feedback=lambda feedback: None, **fields):
        def ask():
            # Called again if the response was dropped, see Peer.call. Feedback of the first goal is then ignored.
            self.feedback = mine = []

            def take(message):
                mine.append(message.feedback)
                on_feedback(message.feedback)

            sent = self.client.send_goal_async(self.type.Goal(**fields), take)
            return self.peer.comes_true(sent.done, graph.ANSWER) and sent

        return graph.wait_for(ask, what="the answer to a goal").result()

    def result(self, handle):
        future = handle.get_result_async()
        self.peer.spin_until(future.done, what="the result")
        return future.result().status, future.result().result

    def cancel(self, handle):
        future = handle.cancel_goal_async()
        self.peer.spin_until(future.done, what="the answer to a cancellation")
        return future.result()


@pytest.fixture(scope="module")
def action_peer(nav2_folder):
    """Return a function that makes the client of an action, given a peer and the name of the action."""
    return ActionPeer


@pytest.fixture(scope="session")
def built_nav2(pytestconfig, tmp_path_factory, worker_id):
    """Return the folder of the package nav2_msgs, built once into pytest's cache, and a dict for its module."""
    import nav2_interfaces

    base = tmp_path_factory.getbasetemp() if worker_id == "master" else tmp_path_factory.getbasetemp().parent
    base = pytestconfig.cache.mkdir("nav2_msgs") if hasattr(pytestconfig, "cache") else base
    folder = base / nav2_interfaces.key()
    with (base / "interfaces.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not (folder / "nav2_msgs").is_dir():
            nav2_interfaces.build(folder)
    return folder, {}


@pytest.fixture(scope="module")
def nav2_folder(built_nav2):
    """Return the folder of the package nav2_msgs, which this process can import during the tests of one file.

    In later files, the controllers in this process would serve the actions, too.
    """
    folder, modules = built_nav2
    sys.path.append(str(folder))
    importlib.invalidate_caches()
    sys.modules.update(modules)
    yield folder
    sys.path.remove(str(folder))
    module = sys.modules.get("nav2_msgs")
    # An installation has a package of its own.
    if module is not None and str(folder) in module.__file__:
        modules["nav2_msgs"] = module
        sys.modules["nav2_msgs"] = None
