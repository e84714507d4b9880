"""Servo angles become servo motion: target channel, last gate, loop, bus. Nothing of speech."""

import logging

logging.getLogger(__name__).addHandler(logging.NullHandler())
