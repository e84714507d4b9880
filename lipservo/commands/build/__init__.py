"""The commands of a builder's first hours: servos found, set up, moved by hand, simulated."""
