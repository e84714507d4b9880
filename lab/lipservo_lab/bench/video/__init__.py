"""Faces on video: how they were tracked, and how our mouth goes with their sound."""
