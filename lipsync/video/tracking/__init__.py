"""Faces in pictures: trackers behind one protocol, and how well they did."""
