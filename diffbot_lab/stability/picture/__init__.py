"""Where V decreases on a grid of states, and what simulated runs show."""
