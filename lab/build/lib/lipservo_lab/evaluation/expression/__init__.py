"""How a face's expression is measured: blinks, saccades, and the head against the voice."""
