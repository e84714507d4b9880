"""Recorded speech rendered to performances, files of a line's motion with its sound."""
