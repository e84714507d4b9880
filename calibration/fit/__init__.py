"""Fits: from captured poses to a calibration."""
