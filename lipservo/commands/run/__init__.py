"""Commands that run a face, watch it and stop it."""
