"""The page of a face: seen, set up and stopped in a browser; and its API for programs."""
