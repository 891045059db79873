"""Where the Lyapunov function decreases under bounded noise: a certificate on a grid of states, and simulated runs."""
