"""Dense, unregistered scans of a talking face become motion of one mesh, and a corpus."""
