"""The servos of one face: put together from its YAML, moved slowly from pose to pose, let go."""
