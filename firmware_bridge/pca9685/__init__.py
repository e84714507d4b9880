"""Hobby servos at a PCA9685 on I2C."""
