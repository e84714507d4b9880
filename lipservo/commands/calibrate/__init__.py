"""`lipservo calibrate`."""
