"""End a process that its middleware would keep for ever.

The Fast DDS 2.14 of the wheels can deadlock while it destroys a participant. It waits there, without a limit, for the
callback that handles another node's discovery. With a C++ library that waits by the system's clock, this limit
overflows: the wait returns at once, again and again, without ever releasing the mutex that the callback needs (Fast-DDS
#6513). rclpy holds Python's lock meanwhile, so neither a thread nor a signal handler of Python can help. It happens to
nodes that end at the same moment, as with Ctrl-C.
"""

from __future__ import annotations

import ctypes
import sys
from collections.abc import Iterator
from contextlib import contextmanager

_CLOCK_MONOTONIC = 1
_SIGEV_THREAD = 2
"""of <time.h> and <signal.h> of Linux"""


class _Expiry(ctypes.Structure):
    """``struct sigevent``: ``function(value)`` is called in a thread of the C library."""

    _fields_ = (
        ("value", ctypes.c_void_p),
        ("signal", ctypes.c_int),
        ("notify", ctypes.c_int),
        ("function", ctypes.c_void_p),
        ("rest", ctypes.c_byte * 40),
    )


class _Due(ctypes.Structure):
    """``struct itimerspec``."""

    _fields_ = tuple((name, ctypes.c_long) for name in ("period_s", "period_ns", "s", "ns"))


@contextmanager
def forced_exit(timeout: int, status: int) -> Iterator[None]:
    """End the process with ``status`` if the block takes longer than ``timeout`` [s], whatever it is doing then.

    Nothing more is flushed, closed or called: what has to arrive must have arrived before.
    """
    sys.stdout.flush()
    libc = ctypes.CDLL(None, use_errno=True)
    timer = ctypes.c_void_p()
    end = _Expiry(value=status, notify=_SIGEV_THREAD, function=ctypes.cast(libc._exit, ctypes.c_void_p))
    if libc.timer_create(_CLOCK_MONOTONIC, ctypes.byref(end), ctypes.byref(timer)):
        raise OSError(ctypes.get_errno(), "timer_create failed")
    try:
        libc.timer_settime(timer, 0, ctypes.byref(_Due(s=timeout)), None)
        yield
    finally:
        libc.timer_delete(timer)
