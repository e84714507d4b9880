"""Learning expression from tracks of somebody's head, eyes and lids; offline."""
