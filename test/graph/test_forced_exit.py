"""The end of a process that cannot end by itself."""

import subprocess
import sys

import graph

HANG = """
import ctypes, time
from diffbot_core.ros.forced_exit import forced_exit

print("before")
with forced_exit(1, {status}):
    {block}
print("after")
"""


def ended(block, status):
    code = HANG.format(block=block, status=status)
    return subprocess.run([sys.executable, "-c", code], check=False, capture_output=True, text=True, timeout=60)


def test_a_process_that_hangs_with_python_locked_ends_with_its_status():
    # A PyDLL keeps Python's lock, so that neither threads nor signal handlers of Python run.
    process = ended("ctypes.PyDLL(None).pause()", 3)
    assert (process.returncode, process.stdout, process.stderr) == (3, "before\n", "")


def test_a_process_that_is_in_time_goes_on():
    process = ended("pass\ntime.sleep(1.5)", status=3)
    assert (process.returncode, process.stdout) == (0, "before\nafter\n")


STUCK = """
import ctypes
from diffbot_core.ros.fault_parameters import FaultConfig
from diffbot_core.ros.node import DiffbotNode, run

class Stuck(DiffbotNode):
    def __init__(self):
        super().__init__("stuck", FaultConfig)

    def before_shutdown(self):
        print("robot stands", flush=True)

    def destroy_node(self):
        ctypes.PyDLL(None).pause()

raise SystemExit(run(Stuck))
"""


def test_a_node_that_the_middleware_keeps_ends_after_its_shutdown():
    with graph.process(sys.executable, "-c", STUCK) as process:
        process.wait_for_output("ready")
        assert process.stop() == 0
        assert "robot stands" in process.output
