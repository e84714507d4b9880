"""Training of the learned expectation. Offline."""
