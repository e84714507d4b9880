"""The ways of `lipservo calibrate`."""
