"""Commands that run a face, show or change its state, and stop it."""
