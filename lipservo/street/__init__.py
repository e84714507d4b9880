"""The way from sound to servos: speech, bridge and clock in one process."""
