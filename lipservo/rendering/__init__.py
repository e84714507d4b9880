"""Lines of speech rendered to performances: the phonemes of a sound, and one line's motion."""
