"""Head, gaze, lids and brows, live: what a face does besides its mouth."""
