"""Traces of what a face did: written while it runs, read, compared and drawn afterwards."""
