"""How the shipped mean face was made of the tracked one; needs trimesh, of the extra `scans`."""
