"""The page of a new face, from the port to its first words: a step a script."""
