"""Calibration measured on robots that its fits were not made for."""
