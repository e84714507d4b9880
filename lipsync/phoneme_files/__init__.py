"""Readers of files of phonemes and their times, written by any program: one reader a format."""
