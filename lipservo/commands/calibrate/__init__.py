"""The commands of `lipservo calibrate`."""
