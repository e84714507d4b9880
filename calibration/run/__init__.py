"""The parts of a calibration that run live: corrections of servo angles. NumPy only."""
