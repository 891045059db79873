"""The filters side by side on the same simulated drives."""
