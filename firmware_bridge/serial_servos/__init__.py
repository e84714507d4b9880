"""Code for all servos that have registers and share a serial line, whatever their protocol."""
