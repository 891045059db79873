"""The closed loop of scalar functions, compiled with numba for campaigns of thousands of runs."""
