"""Faces on a screen: a photograph warped by the face model, a drawn robot, and films of both."""
