"""Real Dynamixel servos: their registers as data, their packets as bytes, and their serial line."""
