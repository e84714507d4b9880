"""Head, gaze and lids as they were learned from a person's tracks; live, NumPy only."""
