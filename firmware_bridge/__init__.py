"""Servo angles become servo motion: channel, last gate, loop, bus. Knows no speech."""
