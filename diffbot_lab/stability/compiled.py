"""Compiles the kernels of the certificates: pure functions of this room and all that they call."""

from __future__ import annotations

import hashlib
from typing import Any

from diffbot_core.code_hash import DIGITS
from diffbot_sim.compiled.jit import compile_kernel, make_callable
from diffbot_sim.compiled.reachable import reachable_functions, source_files


def compile_bounds(kernel: Any) -> Any:
    """Compile a kernel and every function that it reaches by a name; it releases the interpreter's lock.

    The cache is named after the source files of these functions: numba itself looks only at the kernel's own file.
    """
    functions = reachable_functions(kernel)
    digest = hashlib.sha256()
    for path in source_files(functions):
        digest.update(f"{path.name}\n".encode() + path.read_bytes())
    for function in functions:
        if function is not kernel:
            make_callable(function, inline=False)
    return compile_kernel(kernel, f"stability-{digest.hexdigest()[:DIGITS]}")
