"""The servos of one face: built from its YAML, moved from pose to pose, and torque switched off."""
