"""What a face says of its torque, held against its servos: all that is said, and freezes."""
