"""The kinds of calibration that the sub-commands of `lipservo calibrate` make."""
