"""Head, gaze and lids as they were learned from somebody's tracks; live, NumPy only."""
