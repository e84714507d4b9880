"""Simulated robots, with which calibration can be tested and practised without hardware."""
