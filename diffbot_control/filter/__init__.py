"""The extended Kalman filter, its models, gate and adaptation, and the fusion of measurements by their stamps."""
