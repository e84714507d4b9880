"""Videos of a face as recordings: track, check, align with their sound, and write."""
