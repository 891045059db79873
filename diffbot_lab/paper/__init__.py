"""The paper's simulations A and B and their figures."""
