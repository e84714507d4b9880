"""Scripted lines: the model-based method of Edge, Hilton and Jackson, which uses the whole line."""
