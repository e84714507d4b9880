"""Simulated servos, so that a face runs without hardware; they are the default bus."""
