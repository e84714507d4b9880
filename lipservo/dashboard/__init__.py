"""The web dashboard of a face: pages that show, set up and stop it, and an API for programs."""
