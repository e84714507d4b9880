"""The servos of one face: put together from its YAML, moved from pose to pose, let go."""
