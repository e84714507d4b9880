"""Size and grain of the source: what a tick, a stop and a command pass, and lines by room."""
