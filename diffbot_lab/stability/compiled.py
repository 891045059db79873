"""Compiles the kernels of the certificates: pure functions of this room and all that they call."""

from __future__ import annotations

from typing import Any

from diffbot_sim.jit import compile_kernel, source_hash


def compile_bounds(kernel: Any) -> Any:
    """Compile a kernel and every function that it reaches by a name; it releases the interpreter's lock.

    The cache is named after the source files of these functions: numba itself looks only at the kernel's own file.
    """
    return compile_kernel(kernel, f"stability-{source_hash(kernel)}")
