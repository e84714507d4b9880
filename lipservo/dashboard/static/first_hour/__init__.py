"""Scripts of the page that sets up a new face, from the port to its first words."""
