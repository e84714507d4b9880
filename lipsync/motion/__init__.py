"""What moves the mouth live: synthesis by expectation, and closures of the lips."""
