"""Training of a face model from a corpus. Offline."""
