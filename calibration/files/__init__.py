"""The calibration file."""
