"""The servos of one face: put together from its YAML, led slowly from pose to pose, let go."""
