"""The switching Lyapunov law, its regions, limits and goal checker: pure functions of floats, and the supervisor."""
