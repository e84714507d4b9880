"""The status of a running face, and the shared memory in which other processes read it."""
