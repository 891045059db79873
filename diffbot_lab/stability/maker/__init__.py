"""Makes certificates: images of cells under the law, ranks, and the bounds of Omega_L, in plain floats."""
