"""Traces, records of a face's motion: written while it runs; then read, compared and drawn."""
