"""Text becomes sound, with the times of its phonemes and words: no recogniser is needed."""
