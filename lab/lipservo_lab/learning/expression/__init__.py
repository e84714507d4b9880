"""Learning expression from tracks of a person's head, eyes and lids; offline."""
