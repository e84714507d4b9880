"""Lines rendered to performances: the phonemes of a sound, one line, many lines on all cores."""
