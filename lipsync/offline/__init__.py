"""Scripted lines: the model-based method of Edge, Hilton and Jackson, which hears all of a line."""
