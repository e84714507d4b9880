"""The first hour of a face, led by a page: its state, and one child process for each step."""
