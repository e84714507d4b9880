"""Training of the network recogniser. Offline."""
