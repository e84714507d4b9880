"""Lines rendered to performances: what is said in a sound, one line, many lines on all cores."""
