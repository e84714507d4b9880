"""Reading and writing of calibration files."""
