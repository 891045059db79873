"""A name for the code that decides a certificate."""

from __future__ import annotations

from diffbot_core.code_hash import hash_of_code


def name_of_code() -> str:
    """Return a hash of the code that decides a certificate: what was kept before an interruption is of the same."""
    return hash_of_code(("diffbot_core", "diffbot_control", "diffbot_sim", "diffbot_lab"), ("numba", "numpy"))
