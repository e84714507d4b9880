"""Files of phonemes and their times, by any program: one reader a format."""
