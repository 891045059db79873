"""The end of a process that cannot end by itself."""

import subprocess
import sys

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
    for status in (0, 3):
        # A PyDLL keeps Python's lock, so that neither threads nor signal handlers of Python run.
        process = ended("ctypes.PyDLL(None).pause()", status)
        assert (process.returncode, process.stdout, process.stderr) == (status, "before\n", "")


def test_a_process_that_is_in_time_goes_on():
    process = ended("pass\ntime.sleep(1.5)", status=3)
    assert (process.returncode, process.stdout) == (0, "before\nafter\n")
