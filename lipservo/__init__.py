"""The program: puts the street together, from sound to servos."""
