"""Compile the kernels of the certificates: pure functions and all functions that they call."""

from __future__ import annotations

from typing import Any

from diffbot_sim.jit import compile_kernel, source_hash


def compile_bounds(kernel: Any) -> Any:
    """Compile a kernel and every function that it calls by name. The kernel releases the interpreter's lock.

    The cache key contains a hash of the source files of these functions, because numba checks only the kernel's file.
    """
    return compile_kernel(kernel, f"stability-{source_hash(kernel)}")
