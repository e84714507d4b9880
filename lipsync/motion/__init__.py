"""Live motion of the mouth: synthesis by expectation, and closures of the lips."""
