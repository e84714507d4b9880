"""Scripted lines, rendered beforehand: Edge, Hilton and Jackson's method, ours, and their files."""
