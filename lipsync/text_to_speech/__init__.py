"""Text to speech, with the times of phonemes and words, so that no recogniser is needed."""
