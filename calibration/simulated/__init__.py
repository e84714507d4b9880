"""Robots to calibrate without one."""
