"""Commands for scripted lines: the model they are rendered with, and rendering."""
