"""The extended Kalman filter: models, gate, noise statistic, and fusion of measurements in order of their stamps."""
