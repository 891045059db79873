"""Where the Lyapunov function decreases on a grid of states under bounded noise."""
