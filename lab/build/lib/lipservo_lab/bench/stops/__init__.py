"""Stops and signals, on real processes at simulated servos: their campaigns, and their way."""
