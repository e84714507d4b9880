"""The setup of a new face (its first hour), led by a page; each step is a child process."""
