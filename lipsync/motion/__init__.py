"""Live motion of the mouth: by the expectation (predicted mean motion), with lip closures."""
