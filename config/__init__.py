"""Shipped faces and calibrations; installed and read as `lipservo.config`."""
