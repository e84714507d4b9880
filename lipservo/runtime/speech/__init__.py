"""The speech side of a face: from phonemes to targets for servos."""
