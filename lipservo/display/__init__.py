"""Faces on a screen: a photograph that the model warps, a drawn robot, and films of both."""
