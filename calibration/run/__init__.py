"""What the live path uses of a calibration. NumPy only."""
