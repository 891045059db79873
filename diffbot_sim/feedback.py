"""What the controller is fed with in a simulation; apart from the loops, which load the filter's libraries."""

from __future__ import annotations

EKF, RAW, TRUTH = "ekf", "raw", "truth"
FEEDBACKS = (EKF, RAW, TRUTH)
"""The controller's feedback: the filter's estimate, the newest fix as in the paper's simulations, or the true pose."""
