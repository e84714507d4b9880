"""The size of the source: what a tick, a stop and a command pass of it, and lines by room."""
