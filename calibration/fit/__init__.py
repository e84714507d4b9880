"""From captured poses to a calibration."""
