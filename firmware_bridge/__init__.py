"""Servo angles become servo motion: channel, last gate, loop, bus. Knows no speech."""

import logging

logging.getLogger(__name__).addHandler(logging.NullHandler())
