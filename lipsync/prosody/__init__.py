"""Prosody: loudness, pitch, spectral tilt, against the speaker's own baseline."""
