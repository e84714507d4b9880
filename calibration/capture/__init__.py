"""Capture of a robot's face: plans of poses, and the trackers and files of marker positions."""
