"""Prosody of live speech: loudness, pitch and spectral tilt, against the speaker's own baseline."""
