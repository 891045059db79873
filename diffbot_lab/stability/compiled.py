"""Compile the kernels of the certificates."""

from __future__ import annotations

from typing import Any

from diffbot_sim.jit import compile_kernel, source_hash


def compile_bounds(kernel: Any) -> Any:
    """Compile a kernel and every function that it calls by name; see :func:`compile_kernel`.

    The cache has a folder for each hash of the source files of these functions, because numba itself only checks
    whether the kernel's own file has changed.
    """
    return compile_kernel(kernel, f"stability-{source_hash(kernel)}")
