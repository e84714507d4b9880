"""The live motion of head, gaze, lids and brows: everything of a face but its mouth."""
