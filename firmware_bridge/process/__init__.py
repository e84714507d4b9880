"""Processes of one face: bridge, speech, supervisor, and the sockets between them and people."""
