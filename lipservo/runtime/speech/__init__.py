"""The speech side of a face: phonemes in, targets for servos out."""
