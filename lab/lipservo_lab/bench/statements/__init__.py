"""What faces and commands say of torque, held against an independent log of it."""
