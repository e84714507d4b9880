"""Calibrations, one per robot: a regression from face motion to servo angles, kept as text."""
