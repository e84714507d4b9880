"""Rendering whole folders of lines, in several processes or computers."""
