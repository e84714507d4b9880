"""Processor time of a face at rest and speaking, against another checkout of the program."""
