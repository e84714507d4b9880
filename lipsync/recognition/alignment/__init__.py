"""Forced alignment: when each phoneme of a known text was said. Offline."""
