"""Messages and parameters of the nodes ``controller`` and ``ekf``."""
