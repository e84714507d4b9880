"""Hobby servos at a PCA9685, a chip on an I2C bus that makes the pulses of sixteen servos."""
