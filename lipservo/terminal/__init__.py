"""The output to a person's terminal, and the keys read from it."""
